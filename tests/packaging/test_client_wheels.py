"""Every platform that the client is for has the wheels that it needs, also fetched on another one."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from itertools import chain
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROJECT = Path(__file__).parents[2]
WINDOWS = {"platform_system": "Windows", "sys_platform": "win32", "os_name": "nt"}
MACOS = {"platform_system": "Darwin", "sys_platform": "darwin", "os_name": "posix"}


def named_for_windows() -> tuple[list[str], list[str]]:
    """Return what docs/shop-floor.md has `pip download` fetch in addition, without and with the credential store."""
    text = (PROJECT / "docs" / "shop-floor.md").read_text(encoding="utf-8")
    plain = re.search(r"^pip download gridpose (.*?) --dest wheels", text, re.MULTILINE)
    stored = re.search(r"`'gridpose\[keyring\]' (.*?)`", text)
    assert plain is not None
    assert stored is not None
    return plain[1].split(), stored[1].split()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("platform", "version", "system", "with_store"),
    [
        ("win_amd64", "3.11", WINDOWS, False),
        ("win_amd64", "3.12", WINDOWS, True),
        ("win_amd64", "3.14", WINDOWS, False),
        ("macosx_11_0_arm64", "3.11", MACOS, False),
    ],
)
def test_every_platform_finds_wheels(
    platform: str, version: str, system: dict[str, str], with_store: bool, tmp_path: Path
) -> None:
    """What `pip download` of docs/shop-floor.md fetches suffices there; only what resolving needs is fetched here.

    pip judges markers such as `platform_system == "Windows"` by the machine it runs on, so that they are judged anew.
    """
    declared = tomllib.loads((PROJECT / "app" / "client" / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]
    wanted = declared["dependencies"] + (declared["optional-dependencies"]["keyring"] if with_store else [])
    named = named_for_windows()[with_store] if system is WINDOWS else []
    report = tmp_path / "report.json"
    ended = subprocess.run(
        [
            *(sys.executable, "-m", "pip", "install", "-q", "--dry-run", "--report", str(report)),
            *("--target", str(tmp_path / "nothing"), "--platform", platform, "--python-version", version),
            *("--only-binary=:all:", *wanted, *named),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    found = {
        canonicalize_name(each["metadata"]["name"]): each["metadata"].get("requires_dist", [])
        for each in json.loads(report.read_text(encoding="utf-8"))["install"]
    }
    environment = {**system, "python_version": version, "python_full_version": f"{version}.0", "extra": ""}
    needed = {
        canonicalize_name(requirement.name)
        for requirement in map(Requirement, chain.from_iterable([wanted, *found.values()]))
        if requirement.marker is None or requirement.marker.evaluate(environment)
    }
    assert needed <= set(found)
    assert {canonicalize_name(name) for name in named} <= needed, "what is named is what that system needs"
