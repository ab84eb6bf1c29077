"""The code that a kernel is compiled to."""

from __future__ import annotations

import numba

from core.jit import Kernel


def compiled_anew(kernel: Kernel) -> str:
    """Return LLVM's optimised code of the first declared signature: code that was kept comes without."""
    compiled = numba.njit(kernel.declared[0], fastmath=kernel._fastmath, error_model="numpy")(kernel._plain)
    return str(compiled.inspect_llvm(compiled.signatures[0]))
