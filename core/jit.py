"""`jit`: loops over pixels and points that numpy cannot do in one pass, compiled by numba on first use.

A kernel takes and returns plain arrays and numbers. It has a twin in plain numpy that its tests compare it with. Its
machine code is stored on disk (`core.code_cache`) and renewed when its module changes, or the module of a kernel that
it calls, or a constant that it names, and only then.

Compilation costs seconds per signature, so each kernel declares the signatures that it needs: an installation compiles
those ahead (`app.jobs.warm_up`), module by module, in several processes. A call whose types convert to a declared
signature without loss (a literal, a contiguous array where any is accepted) uses that code. A call that fits none is
compiled on demand.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import inspect
from collections.abc import Callable, Iterator
from typing import Any, TypeVar, cast, overload

_OPT_LEVEL = 1
"""LLVM's. Levels 2 and 3 take longer and yield kernels of the same speed: numba has loops vectorised at all of them, as
long as what they call is small or `inlined`."""
_GC_THRESHOLDS = (200_000, 20, 100)
"""Where many long-lived objects are made: with the usual thresholds numba spends a fifth of its time on them."""

Function = TypeVar("Function", bound=Callable[..., Any])


@overload
def jit(kernel: Function, /) -> Function: ...


@overload
def jit(
    *signatures: str, reassociates: bool = ..., inlined: bool = ...
) -> Callable[[Function], Function]: ...


def jit(*kernel_or_signatures: Any, reassociates: bool = False, inlined: bool = False) -> Any:
    """Return the function compiled for each of the declared signatures, or for the types of its first call.

    A signature lists the argument types in numba's notation, without the return type: `"u1[:,::1], f8[:], i8"`.

    Division by zero gives infinities and NaN, as in numpy. The global interpreter lock is free while a kernel runs.
    numba itself, a quarter of a second and 65 MB, is imported by the first call: processes that import kernels and run
    none do without it. A kernel that `reassociates` leaves the order of its sums, and whether a product is rounded
    before it is added, to the processor's vectors; infinities and NaN are what they are elsewhere. One that is
    `inlined` becomes part of the kernels that call it, which LLVM decides for small ones alone: a loop with a call is
    not vectorised.
    """
    if len(kernel_or_signatures) == 1 and callable(kernel_or_signatures[0]):
        return Kernel(kernel_or_signatures[0], (), reassociates, inlined)
    return lambda kernel: Kernel(kernel, kernel_or_signatures, reassociates, inlined)


class Kernel:
    """Stands for numba's function, which it makes when it is first called or asked for anything."""

    def __init__(
        self, function: Callable[..., Any], signatures: tuple[str, ...], reassociates: bool, inlined: bool
    ) -> None:
        plain = inspect.unwrap(function)  # without the shape checks that tests wrap around every function
        functools.update_wrapper(self, plain)
        self._plain = plain
        self._fastmath = {"reassoc", "contract", "nsz"} if reassociates else False
        self._inlined = inlined
        self.declared = signatures
        """Argument types, in numba's notation, for which an installation compiles the kernel ahead."""

    def compile_declared(self, signature: str) -> None:
        """Compile for one of the declared signatures, or load the stored code."""
        self._dispatcher.compile(_parsed(signature))

    @functools.cached_property
    def _dispatcher(self) -> Any:
        try:
            return self._compiled()
        except AttributeError as error:
            # Python takes an AttributeError in here for a missing attribute of ours, and asks `__getattr__` instead.
            raise ImportError(
                f"numba cannot compile {self._plain.__qualname__}: {error}. Its installation may be damaged, or of a "
                "version that does not go with this numpy."
            ) from error

    def _compiled(self) -> Any:
        from core.code_cache import CodeCache

        options = {
            "nopython": True,
            "nogil": True,
            "error_model": "numpy",
            "fastmath": self._fastmath,
            "forceinline": self._inlined,
        }
        declared = tuple(map(_parsed, self.declared))
        dispatcher = _dispatcher_type()(self._plain, options, declared)
        with contextlib.suppress(OSError):  # there is no file of the source: typed in, or from an archive
            dispatcher._cache = CodeCache(self._plain)
        return dispatcher

    @property
    def _numba_type_(self) -> Any:
        """What numba asks of a name that another kernel calls."""
        return self._dispatcher._numba_type_

    def __call__(self, *arguments: Any) -> Any:
        return self._dispatcher(*arguments)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name in ("_plain", "_fastmath", "_inlined", "declared"):
            raise AttributeError(name)
        return getattr(self._dispatcher, name)


@functools.cache
def _dispatcher_type() -> Any:
    """Return numba's dispatcher, which compiles for declared signatures where they fit the types of a call."""
    from numba.core import config, sigutils, types
    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.registry import CPUDispatcher
    from numba.core.typeconv.castgraph import Conversion

    config.OPT = type(config.OPT)(_OPT_LEVEL)  # type: ignore[attr-defined]  # before numba makes its code generator

    class Dispatcher(CPUDispatcher):
        def __init__(
            self, function: Callable[..., Any], options: dict[str, Any], declared: tuple[Any, ...]
        ) -> None:
            super().__init__(py_func=function, targetoptions=options)
            self._declared = declared

        def compile(self, signature: Any) -> Any:
            arguments, _ = sigutils.normalize_signature(signature)  # type: ignore[no-untyped-call]
            with global_compiler_lock, few_collections():
                return super().compile(self._fitting(tuple(map(types.unliteral, arguments))))

        def _fitting(self, arguments: tuple[Any, ...]) -> tuple[Any, ...]:
            """Return the first declared signature that the types convert to without loss, else the types."""
            if arguments in self._declared:
                return arguments
            for declared in self._declared:
                if len(declared) == len(arguments) and all(
                    conversion is not None and conversion <= Conversion.safe
                    for conversion in map(self.typingctx.can_convert, arguments, declared)
                ):
                    return cast("tuple[Any, ...]", declared)
            return arguments

    return Dispatcher


@functools.cache
def _parsed(signature: str) -> tuple[Any, ...]:
    from numba.core import sigutils

    arguments, _ = sigutils.normalize_signature(f"({signature},)")  # type: ignore[no-untyped-call]
    return tuple(arguments)


@contextlib.contextmanager
def few_collections() -> Iterator[None]:
    """Look for garbage seldom: for work that makes many objects which stay to its end."""
    before = gc.get_threshold()
    gc.set_threshold(*_GC_THRESHOLDS)
    try:
        yield
    finally:
        gc.set_threshold(*before)
