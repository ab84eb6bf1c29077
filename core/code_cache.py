"""Where the machine code of kernels is kept: one file per kernel and signature, named by what it was compiled from.

A file's name holds hashes of name and source of the kernel's module and of the modules of the kernels that it calls, of
the constants that these name, and of the signature, the processor, and the versions of Python, numba and LLVM. Neither
path nor time counts: a copy of the program, a second checkout and a file that was touched find what was compiled
before. A file begins with the hash of its content; one that is damaged is as good as
absent. Files are written whole and replaced in one step, and there is no index, so any number of processes may read
and write at once.

Code is looked for in every folder there is, in a folder that may only be read as well: an installation compiled by
its owner and run by another user, as in a container, compiles nothing. What is compiled is kept in the first folder
that can be written: `NUMBA_CACHE_DIR` where it is set, else `__pycache__` of the kernel's module, else the user's
cache.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import inspect
import os
import pickle
import secrets
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import CodeType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import config
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps
from numba.misc.appdirs import AppDirs

_DIGEST_BYTES = hashlib.sha256().digest_size
_MAX_AGE_S = 30 * 86400.0
"""Code of other versions of a module is removed at this age, when new code is saved alongside it."""


class CodeCache(NullCache):
    """The kept code of one kernel, as numba's dispatcher asks for it."""

    def __init__(self, kernel: Callable[..., Any]) -> None:
        path = Path(inspect.getfile(kernel))
        self._kernel = kernel
        self._name = f"{path.stem}.{kernel.__qualname__}".replace("<", "").replace(">", "")
        in_tree, of_the_user = path.parent / "__pycache__", _user_folder()
        chosen = [Path(config.CACHE_DIR)] if config.CACHE_DIR else []  # type: ignore[attr-defined]
        known_home = [of_the_user] if of_the_user.is_absolute() else []  # else there is no home
        self._read_from = [in_tree, *chosen, *known_home]
        self._write_to = chosen or [in_tree, *known_home]

    @functools.cached_property
    def _source(self) -> str:
        """The hash of what is compiled. A kernel's module is not yet whole when the kernel is made, so this waits."""
        return _short_hash(repr(sorted(_compiled_parts(self._kernel))).encode())

    @property
    def cache_path(self) -> str:
        """The folder that is looked into first."""
        return str(self._read_from[0])

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Return the compiled kernel for `signature`, or None where none is kept."""
        target_context.refresh()
        key = self._key(signature, target_context.codegen())
        for folder in self._read_from:
            kept = _read(folder / self._file_name(key), key)
            if kept is not None:
                return CompileResult._rebuild(target_context, *kept)  # type: ignore[no-untyped-call]
        return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep a compiled kernel in the first folder that can be written; without one it is not kept."""
        if compiled.library.has_dynamic_globals or any(not loop.can_cache for loop in compiled.lifted):
            return  # it holds addresses of this process
        key = self._key(signature, compiled.codegen)
        content = _pickled((key, compiled._reduce()))
        for folder in self._write_to:
            with contextlib.suppress(OSError):
                folder.mkdir(parents=True, exist_ok=True)
                _write(folder / self._file_name(key), hashlib.sha256(content).digest() + content)
                self._remove_outdated(folder)
                return

    def _key(self, signature: Any, codegen: Any) -> tuple[str, ...]:
        """Name all that the machine code depends on besides the source of the module."""
        versions = (
            *(numba.__version__, llvmlite.__version__, sys.implementation.cache_tag),
            f"O{int(config.OPT)}",  # type: ignore[attr-defined]
        )
        enclosed = tuple(cell.cell_contents for cell in self._kernel.__closure__ or ())
        body = _short_hash(self._kernel.__code__.co_code + _pickled(enclosed))
        return (*versions, body, str(signature), *map(str, codegen.magic_tuple()))

    def _file_name(self, key: tuple[str, ...]) -> str:
        return f"{self._name}-{self._source}-{_short_hash(repr(key).encode())}.nbc"

    def _remove_outdated(self, folder: Path) -> None:
        oldest = time.time() - _MAX_AGE_S
        for file in folder.glob(f"{self._name}-*.nbc"):
            if self._source not in file.name and file.stat().st_mtime < oldest:
                file.unlink(missing_ok=True)


def _compiled_parts(kernel: Callable[..., Any]) -> set[str]:
    """Return names and hashes of the modules of a kernel and of all that it calls, and of the constants they name.

    Kept code imports its module by name: of one that was renamed it is of no use.
    """
    parts, seen, waiting = set(), {kernel}, [kernel]
    while waiting:
        function = waiting.pop()
        parts.add(f"{function.__module__} {_source_hash(Path(inspect.getfile(function)))}")
        for name in _global_names(function.__code__) & function.__globals__.keys():
            value = function.__globals__[name]
            called = inspect.unwrap(value) if callable(value) else None
            if inspect.isfunction(called):
                if called not in seen:
                    seen.add(called)
                    waiting.append(called)
            elif isinstance(value, bool | int | float | str | tuple | np.ndarray):
                parts.add(f"{name} {_short_hash(_pickled(value))}")
    return parts


def _global_names(code: CodeType) -> set[str]:
    inner = [_global_names(constant) for constant in code.co_consts if isinstance(constant, CodeType)]
    return set(code.co_names).union(*inner)


@functools.cache
def _source_hash(path: Path) -> str:
    return _short_hash(path.read_bytes())


def _user_folder() -> Path:
    return Path(AppDirs("gridpose", False).user_cache_dir)  # type: ignore[no-untyped-call]


def _pickled(value: Any) -> bytes:
    """Pickle as numba does, which knows its own types."""
    return bytes(dumps(value))  # type: ignore[no-untyped-call]


def _short_hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:20]


def _read(path: Path, key: tuple[str, ...]) -> Any:
    """Return what was kept under `key`; None where the file is absent, cannot be read, or is damaged."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    digest, content = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        return None
    kept_under, kept = pickle.loads(content)  # noqa: S301 - a file of our own, whole by its hash
    return kept if kept_under == key else None


def _write(path: Path, content: bytes) -> None:
    temporary = path.with_name(f"{path.name}.{os.getpid()}.{secrets.token_hex(4)}")
    try:
        temporary.write_bytes(content)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
