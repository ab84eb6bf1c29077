"""Compiled kernels: loops over pixels that numpy cannot do in one pass, compiled by numba on first use.

A kernel takes and returns plain arrays and numbers, has a twin in plain numpy that its tests compare it with, and
is kept on disk once compiled, where there is a place to keep it. What is kept is renewed when the kernel's own module
changes, and only then; what it calls and the constants it names are part of it. So kernels that call one another live
in one module, together with their constants.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any, TypeVar, cast, overload

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


@overload
def compiled(kernel: Kernel) -> Kernel: ...


@overload
def compiled(*, reassociates: bool) -> Callable[[Kernel], Kernel]: ...


def compiled(
    kernel: Kernel | None = None, *, reassociates: bool = False
) -> Kernel | Callable[[Kernel], Kernel]:
    """Return the function compiled for the types it is first called with.

    The machine code is kept beside the module or, where that may not be written, in the user's cache; in an
    installation without either it is compiled anew in each process. Division by zero gives infinities and NaN, as in
    numpy. The global interpreter lock is free while a kernel runs. numba itself, a quarter of a second and 65 MB, is
    imported by the first call: processes that import kernels and run none do without it. A kernel that `reassociates`
    leaves the order of its sums, and whether a product is rounded before it is added, to the processor's vectors;
    infinities and NaN are what they are elsewhere.
    """
    if kernel is None:
        return lambda kernel: _wrapped(kernel, reassociates)
    return _wrapped(kernel, reassociates)


def _wrapped(kernel: Kernel, reassociates: bool) -> Kernel:
    plain = inspect.unwrap(kernel)  # without the checks of shapes that the tests wrap around every function
    return cast("Kernel", _CompiledOnFirstUse(plain, reassociates))


class _CompiledOnFirstUse:
    """Stands for numba's function, which it makes when it is first called or asked for anything."""

    def __init__(self, plain: Callable[..., Any], reassociates: bool) -> None:
        functools.update_wrapper(self, plain)
        self._plain = plain
        self._fastmath = {"reassoc", "contract", "nsz"} if reassociates else False

    @functools.cached_property
    def _dispatcher(self) -> Any:
        from numba import njit

        try:
            return njit(cache=True, nogil=True, error_model="numpy", fastmath=self._fastmath)(self._plain)
        except RuntimeError:  # numba's "no locator available": nowhere to keep it
            return njit(nogil=True, error_model="numpy", fastmath=self._fastmath)(self._plain)

    @property
    def _numba_type_(self) -> Any:
        """What numba asks of a name that another kernel calls."""
        return self._dispatcher._numba_type_

    def __call__(self, *arguments: Any) -> Any:
        return self._dispatcher(*arguments)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self._dispatcher, name)
