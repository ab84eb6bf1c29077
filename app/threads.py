"""How many threads numpy takes: this module imports nothing, so that it can be called before numpy is loaded."""

from __future__ import annotations

import os

_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def limit_threads() -> None:
    """Let numpy work in one thread, in this process where it is not loaded yet, and in those it starts.

    The matrices here are small: threads that wait for one another gain little, and alongside other work on the same
    cores they made fits up to six times slower. What a user has set stays.
    """
    for variable in _VARIABLES:
        os.environ.setdefault(variable, "1")
