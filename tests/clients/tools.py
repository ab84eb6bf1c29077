"""The linters, generators and compilers, pinned, in a folder that git ignores; installed where they are missing."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
PROJECT = HERE.parents[1]
WORK = PROJECT / "build" / "clients"
OPENAPI = PROJECT / "openapi.json"
_MIN_NODE = (20, 19)
_JAVA = Path("/usr/share/java")
_JAVA_PACKAGES = {
    "jakarta-annotation-api.jar": "libjakarta-annotation-api-java",
    "httpmime.jar": "libhttpmime-java",
    "httpclient.jar": "libhttpclient-java",
    "httpcore.jar": "libhttpcore-java",
}
"""What generated Java imports and the generator's own JAR does not have."""


class CheckFailed(Exception):
    """A step failed; the message is what it printed."""


class Tools:
    """Where the tools are."""

    def __init__(self) -> None:
        self.python = WORK / "venv" / "bin" / "python"
        self.node_modules = WORK / "node" / "node_modules"
        self.generator_jar = Path()

    @property
    def java_libraries(self) -> list[Path]:
        """The JARs that the generated Java needs."""
        return [self.generator_jar, *(_JAVA / jar for jar in _JAVA_PACKAGES)]

    def command(self, name: str) -> str:
        """Return the path of a program of one of the packages."""
        folder = self.node_modules / ".bin"
        return str(folder / name if (folder / name).exists() else self.python.parent / name)

    def install(self) -> None:
        """Install what is missing: Node and a JDK by apt-get, packages by pip and npm against their hashes."""
        if _node_version() < _MIN_NODE:
            _apt_install("nodejs", "npm")
        if _node_version() < _MIN_NODE:
            raise CheckFailed(f"Node {'.'.join(map(str, _MIN_NODE))} or later is needed; put it on the PATH.")
        if shutil.which("npm") is None:
            _apt_install("npm")
        if shutil.which("javac") is None:
            _apt_install("default-jdk-headless")
        missing = [package for jar, package in _JAVA_PACKAGES.items() if not (_JAVA / jar).exists()]
        if missing:
            _apt_install(*missing)
        self._install_python()
        self._install_node()
        jars = sorted(WORK.glob("venv/lib/python*/site-packages/openapi_generator_cli/*.jar"))
        if not jars:
            raise CheckFailed("openapi-generator-cli came without its JAR.")
        self.generator_jar = jars[0]

    def _install_python(self) -> None:
        requirements = HERE / "requirements.txt"
        if _is_current(WORK / "venv", requirements):
            return
        run([sys.executable, "-m", "venv", "--clear", str(WORK / "venv")])
        pip = [str(self.python), "-m", "pip", "install", "-qq", "--disable-pip-version-check"]
        run([*pip, "--require-hashes", "-r", str(requirements)])
        _set_current(WORK / "venv", requirements)

    def _install_node(self) -> None:
        folder, names = WORK / "node", ("package.json", "package-lock.json", ".npmrc")
        if _is_current(folder, HERE / "package-lock.json"):
            return
        folder.mkdir(parents=True, exist_ok=True)
        for name in names:
            shutil.copy(HERE / name, folder / name)
        run(
            ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--loglevel", "error"], folder=folder
        )
        _set_current(folder, HERE / "package-lock.json")


@dataclass(frozen=True)
class Printed:
    """What a command printed."""

    out: str
    err: str


def run(
    command: Sequence[str],
    *,
    folder: Path | None = None,
    environment: Mapping[str, str] | None = None,
    may_fail: bool = False,
) -> Printed:
    """Run a command and return what it printed; CheckFailed where it fails and may not."""
    ended = subprocess.run(
        command,
        cwd=folder or WORK,
        env={**os.environ, **(environment or {})},
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    if ended.returncode != 0 and not may_fail:
        said = ended.stdout[-4000:] + ended.stderr[-4000:]
        raise CheckFailed(f"{' '.join(command[:4])} ended with {ended.returncode}:\n{said}")
    return Printed(ended.stdout, ended.stderr)


def _node_version() -> tuple[int, ...]:
    if shutil.which("node") is None:
        return (0,)
    return tuple(int(part) for part in run(["node", "--version"]).out.strip().lstrip("v").split(".")[:2])


def _apt_install(*packages: str) -> None:
    print("installing", *packages, flush=True)
    root = [] if os.geteuid() == 0 else ["sudo"]
    run([*root, "apt-get", "update", "-qq"])
    run([*root, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "install", "-y", "-qq", *packages])


def _is_current(folder: Path, source: Path) -> bool:
    stamp = folder / ".installed"
    return stamp.exists() and stamp.read_text() == _hash(source)


def _set_current(folder: Path, source: Path) -> None:
    (folder / ".installed").write_text(_hash(source))


def _hash(source: Path) -> str:
    return hashlib.sha256(source.read_bytes()).hexdigest()
