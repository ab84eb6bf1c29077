"""Rendered scenes, kept on disk: rendering 5 Mpx takes a second of processor time, reading them back some ms.

`render` and `render_levels` replace those of `core.simulation.renderer` wherever a test needs an image and does
not test the renderer itself. The key is a hash of the scene, of the sources that draw it and of the versions of numpy
and OpenCV. `GRIDPOSE_TEST_RENDERS` names another folder than the user's cache; empty, nothing is kept.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import functools
import hashlib
import importlib.util
import os
import uuid
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np
import platformdirs

from core.simulation import renderer
from core.simulation.scenes import Scene

MAX_BYTES = 1_500_000_000


def render(scene: Scene) -> np.ndarray:
    """Return `core.simulation.renderer.render(scene)`, (h, w) uint8 or uint16; the caller may write into it."""
    return _kept(renderer.render, scene)


def render_levels(scene: Scene) -> np.ndarray:
    """Return `core.simulation.renderer.render_levels(scene)`, (h, w) float32; the caller may write into it."""
    return _kept(renderer.render_levels, scene)


def write_renders(files: Mapping[Path, Scene], *_: object) -> None:
    """Write the files that a demo's `render_images` would render, each whole when it appears."""
    for path, scene in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        part.write_bytes(cv2.imencode(path.suffix, render(scene))[1].tobytes())
        part.replace(path)


def _kept(draw: Callable[[Scene], np.ndarray], scene: Scene) -> np.ndarray:
    folder = cache_folder()
    if folder is None:
        return draw(scene)
    path = folder / f"{_key(draw.__name__, scene)}.npy"
    with contextlib.suppress(FileNotFoundError):  # not rendered yet, or removed meanwhile by another process
        image = np.load(path)
        os.utime(path)  # the longest unused go first
        return np.asarray(image)
    image = draw(scene)
    folder.mkdir(parents=True, exist_ok=True)
    # Written whole under another name, then renamed: processes side by side see all of a file or none.
    unfinished = folder / f"{uuid.uuid4().hex}.unfinished"
    with unfinished.open("wb") as file:
        np.save(file, image)
    unfinished.replace(path)
    _remove_oldest(folder, MAX_BYTES)
    return image


def cache_folder() -> Path | None:
    """Return where renders are kept; None where they are not."""
    stated = os.environ.get("GRIDPOSE_TEST_RENDERS")
    if stated is None:
        return platformdirs.user_cache_path("gridpose") / "test-renders"
    return Path(stated) if stated else None


def _remove_oldest(folder: Path, max_bytes: int) -> None:
    files = []
    for path in folder.iterdir():
        with contextlib.suppress(FileNotFoundError):  # renamed or removed by another process
            status = path.stat()
            files.append((status.st_mtime, status.st_size, path))
    total = 0
    for _, size, path in sorted(files, reverse=True):
        total += size
        if total > max_bytes:
            path.unlink(missing_ok=True)


def _key(function: str, scene: Scene) -> str:
    digest = hashlib.sha256(f"{function} {_renderer_hash()}".encode())
    _add(digest, scene)
    return digest.hexdigest()


def _add(digest: hashlib._Hash, value: object) -> None:
    """Add a value, its fields one by one, to the hash; what no scene holds today is refused."""
    if dataclasses.is_dataclass(value):
        digest.update(type(value).__name__.encode())
        for field in dataclasses.fields(value):
            digest.update(field.name.encode())
            _add(digest, getattr(value, field.name))
    elif isinstance(value, np.ndarray):
        digest.update(f"{value.dtype.str}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, tuple):
        digest.update(f"tuple {len(value)}".encode())
        for item in value:
            _add(digest, item)
    elif value is None or isinstance(value, (bool, int, float, str)):
        digest.update(f"{type(value).__name__} {value!r};".encode())
    else:
        raise TypeError(f"A {type(value).__name__} in a scene has no hash yet.")


@functools.cache
def _renderer_hash() -> str:
    """Return a hash of the renderer's source, of all of core that it imports, and of the libraries' versions."""
    digest = hashlib.sha256(f"numpy {np.__version__}, OpenCV {cv2.__version__}".encode())
    waiting, seen = [renderer.__name__], {renderer.__name__}
    while waiting:
        specification = importlib.util.find_spec(waiting.pop())
        if specification is None or specification.origin is None:
            continue
        source = Path(specification.origin).read_bytes()
        digest.update(source)
        for name in _imported(ast.parse(source)):
            if name.split(".")[0] == "core" and name not in seen:
                seen.add(name)
                waiting.append(name)
    return digest.hexdigest()


def _imported(tree: ast.Module) -> list[str]:
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.append(node.module)
            names += [f"{node.module}.{alias.name}" for alias in node.names]  # a module, or a name within one
    return [name for name in names if _is_module(name)]


def _is_module(name: str) -> bool:
    if not name.startswith("core."):
        return False
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:  # a name within a module that is no package
        return False
