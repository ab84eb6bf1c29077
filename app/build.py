"""Version and build id: a hash of the sources distinguishes builds of one version.

The hash is over the files as they lie on the disk, by their names within the package and with LF line endings. It is
the same in a checkout, a wheel and a container, wherever they lie. An installation stripped to compiled files (`.pyc`
in place of `.py`) is hashed by these and marked `pyc`: such builds are distinguished from one another, and never equal
one that has sources.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
from collections.abc import Iterator
from functools import cache
from pathlib import Path

_LIBRARIES = ("matplotlib", "numba", "numpy", "scipy")
"""Libraries whose version may change the last digits, or the drawing, of an analysis."""


@cache
def program_version() -> str:
    """Return this program's version, as installed: that of the service, or of the client, which is the same."""
    try:
        return importlib.metadata.version("gridpose-server")
    except (
        importlib.metadata.PackageNotFoundError
    ):  # an environment set up before the client was a project of its own
        return importlib.metadata.version("gridpose")


@cache
def core_version() -> str:
    """Return the version with the build of the numerics, what a result was computed by: `0.1.0+b3f2a91c04de`."""
    version = program_version()
    return f"{version}{'.' if '+' in version else '+'}{sources_hash('core')}"


@cache
def analyses_build() -> str:
    """Return a hash of all that makes an analysis' bytes of its inputs: core, the service, and numerical libraries."""
    libraries = " ".join(f"{name}={importlib.metadata.version(name)}" for name in _LIBRARIES)
    text = f"{sources_hash('core')} {sources_hash('app')} {libraries}"
    return hashlib.sha256(text.encode()).hexdigest()


def sources_hash(package: str) -> str:
    """Return 12 hex digits of the SHA-256 over a package's sources; the package is not imported.

    Raises ModuleNotFoundError where the package is not installed as files.
    """
    specification = importlib.util.find_spec(package)
    folders = specification.submodule_search_locations if specification is not None else None
    if not folders:
        raise ModuleNotFoundError(f"the package `{package}` is not installed")
    root = Path(next(iter(folders)))
    digest = hashlib.sha256()
    mark = ""
    files = sorted(_files(root, ".py"))
    if not files:
        mark, files = "pyc.", sorted(_files(root, ".pyc"))
    if not files:
        raise ModuleNotFoundError(f"the package `{package}` is not installed as files")
    for name, path in files:
        content = path.read_bytes()
        # A compiled file begins with 16 bytes that hold the time and size of its source.
        content = content[16:] if mark else content.replace(b"\r\n", b"\n")
        digest.update(f"{name}\0{len(content)}\0".encode())
        digest.update(content)
    return mark + digest.hexdigest()[:12]


def _files(root: Path, suffix: str) -> Iterator[tuple[str, Path]]:
    for path in root.rglob(f"*{suffix}"):
        if "__pycache__" not in path.parts:
            yield path.relative_to(root).as_posix(), path
