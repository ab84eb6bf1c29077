"""What README.md and docs/quickstart.md show is what happens: commands are run, answers compared."""

from __future__ import annotations

import contextlib
import io
import math
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.core import TyperGroup as Group
from typer.main import get_command

from app.api.schemas.measurements import MeasurementRead
from app.cli.demo.service_process import ServiceProcess
from app.cli.main import app
from app.client import ServiceClient
from app.settings import Settings

PROJECT = Path(__file__).parents[2]
README, QUICKSTART, CONFIGURATION = (
    (PROJECT / path).read_text(encoding="utf-8")
    for path in ("README.md", "docs/quickstart.md", "docs/configuration.md")
)
LINKED = [
    "README.md",
    "CONTRIBUTING.md",
    *sorted(str(p.relative_to(PROJECT)) for p in (PROJECT / "docs").rglob("*.md")),
]

# Quoted text, numbers, words, punctuation; white space is of no account.
_TOKEN = re.compile(r'\.\.\.|"[^"]*"|-?\d+(?:\.\d+)?(?:e[-+]?\d+)?|[^\W\d]\w*|[^\s\w]')
_ID = re.compile(r"\b[a-z]{3}_[0-9a-z]{26}\b")
# The last digits of a fit vary between processors; what is shown must agree well below its uncertainty.
_RELATIVE, _ABSOLUTE = 1e-2, 1e-4


def block(marker: str) -> str:
    """Return the fenced block after `<!-- marker -->` of README.md or docs/quickstart.md."""
    match = re.search(rf"<!-- {marker} -->\n```\w+\n(.*?)```", README + QUICKSTART, re.DOTALL)
    assert match is not None, f"there is no block {marker}"
    return match[1]


def agree(shown: str, actual: str) -> bool:
    """Return whether two tokens are the same, or numbers that are nearly so."""
    try:
        return math.isclose(float(shown), float(actual), rel_tol=_RELATIVE, abs_tol=_ABSOLUTE)
    except ValueError:
        return shown == actual


def assert_shows(shown: str, actual: str) -> None:
    """Check that what is shown is in the answer, piece by piece in order; `...` leaves something out."""
    answer = _TOKEN.findall(actual)
    position = 0
    for piece in shown.split("..."):
        tokens = _TOKEN.findall(piece)
        last = len(answer) - len(tokens)
        while (
            not all(agree(*pair) for pair in zip(tokens, answer[position:], strict=False)) or position > last
        ):
            position += 1
            assert position <= last, f"the document shows {piece!r}, the answer was {actual}"
        position += len(tokens)


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
def test_the_curl_session(service: ServiceProcess, data_folder: Path, tmp_path: Path) -> None:
    shutil.copy(data_folder / "opencv_samples" / "left12.jpg", tmp_path)
    steps = [step.split("\n", 1) for step in re.split(r"^\$ ", block("curl"), flags=re.MULTILINE)[1:]]
    steps = [step for step in steps if step[0].startswith("curl")]
    assert len(steps) == 5
    environment = {
        **os.environ,
        "URL": f"{service.url}/v1",
        "AUTH": f"Authorization: Bearer {service.admin_key}",
    }
    ids: dict[str, str] = {}
    for command, shown in steps:
        for said, real in ids.items():
            command = command.replace(said, real)
        if measurement := re.search(r"measurements/(\w+)$", command):
            _wait_until_computed(service, measurement[1])
        ended = subprocess.run(
            ["bash", "-c", command], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        )
        for said, real in zip(_ID.findall(shown), _ID.findall(ended.stdout), strict=False):
            ids.setdefault(said, real)
            shown = shown.replace(said, real)
        assert_shows(shown, ended.stdout)
    assert len(ids) == 3
    assert (tmp_path / "overlay.png").read_bytes().startswith(b"\x89PNG")


def _wait_until_computed(service: ServiceProcess, measurement_id: str) -> None:
    deadline = time.monotonic() + 240
    with ServiceClient(service.url, service.admin_key) as client:
        while client.get(f"/v1/measurements/{measurement_id}")["status"] not in ("succeeded", "failed"):
            assert time.monotonic() < deadline, "the photograph was not computed"


def test_the_five_lines_of_python(data_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code, comments = block("python").split("\n\n# ")
    assert len(list(filter(None, code.splitlines()))) == 5
    monkeypatch.chdir(data_folder / "opencv_samples")
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        exec(compile(code, "README.md", "exec"), {})
    shown = "".join(line.removeprefix("# ") for line in comments.splitlines(keepends=True))
    assert len(_TOKEN.findall(shown)) == len(_TOKEN.findall(output.getvalue()))
    assert_shows(shown, output.getvalue())


def test_the_target_is_printed(tmp_path: Path) -> None:
    command = block("target").split()
    assert command[0] == "gridpose"
    subprocess.run([sys.executable, "-m", "app.cli", *command[1:]], cwd=tmp_path, check=True, timeout=120)
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF-")


def test_the_table_of_settings_is_complete() -> None:
    table = CONFIGURATION.split("## Settings")[1].split("## ")[0]
    rows = dict(re.findall(r"^\| `(GRIDPOSE_\w+)` \| (.*?) \|", table, re.MULTILINE))
    assert set(rows) == {f"GRIDPOSE_{name.upper()}" for name in Settings.model_fields}
    for name, field in Settings.model_fields.items():
        shown = rows[f"GRIDPOSE_{name.upper()}"]
        if isinstance(field.default, int | float | str):
            default = f"{field.default:g}" if isinstance(field.default, float) else str(field.default)
            assert shown == f"`{default}`"
        else:
            assert "`" not in shown


def test_the_commands_and_fields_that_are_named_exist() -> None:
    commands = get_command(app)
    named = set(re.findall(r"`?\bgridpose ([a-z]+)(?: ([a-z]+))?", README + QUICKSTART))
    for first, second in named:
        assert isinstance(commands, Group)
        assert first in commands.commands, first
        inner = commands.commands[first]
        if isinstance(inner, Group):
            assert second in inner.commands, (first, second)
    assert {("targets", "print"), ("targets", "check")} <= named
    shown = set(re.findall(r"`(\w+)`", QUICKSTART))
    assert {"capture_quality", "siblings", "target_id"} <= shown & set(MeasurementRead.model_fields)


@pytest.mark.parametrize("document", LINKED)
def test_what_a_document_links_to_is_there(document: str) -> None:
    path = PROJECT / document
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", path.read_text(encoding="utf-8"))
    assert [link for link in links if not (path.parent / link).exists()] == []


def test_make_has_the_targets_that_readme_names() -> None:
    targets = sorted(set(re.findall(r"\bmake (\w+)", README)))
    assert targets
    subprocess.run(["make", "--dry-run", *targets], cwd=PROJECT, stdout=subprocess.DEVNULL, check=True)
