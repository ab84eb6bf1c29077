"""The one decorator of compiled kernels."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from core.compiled import compiled

KERNEL = """
import numpy as np
from core.compiled import compiled

@compiled
def total(values):
    result = 0.0
    for value in values:
        result += value / 2.0
    return result

print(total(np.arange(5.0)))
"""


@compiled
def _ratio(a: np.ndarray, b: np.ndarray) -> float:
    total = 0.0
    for i in range(len(a)):
        total += a[i] / b[i]
    return total


def test_a_kernel_is_compiled_and_divides_as_numpy_does() -> None:
    assert _ratio(np.array([1.0, 2.0]), np.array([2.0, 4.0])) == 1.0
    assert _ratio(np.array([1.0]), np.array([0.0])) == np.inf
    assert _ratio.signatures  # type: ignore[attr-defined]


@compiled
def _sum_of_ratios(a: np.ndarray, b: np.ndarray) -> float:
    return _ratio(a, b) + _ratio(b, a)


def test_kernels_call_one_another() -> None:
    assert _sum_of_ratios(np.array([1.0, 2.0]), np.array([2.0, 4.0])) == 5.0


def test_importing_kernels_does_not_import_numba(tmp_path: Path) -> None:
    module = tmp_path / "kernel.py"
    unused = KERNEL.replace("print(total(np.arange(5.0)))", "import sys; print('numba' in sys.modules)")
    module.write_text(unused, encoding="utf-8")
    assert _run(module, tmp_path).strip() == "False"


def test_machine_code_is_kept_and_used_by_the_next_process(tmp_path: Path) -> None:
    module = tmp_path / "kernel.py"
    module.write_text(KERNEL, encoding="utf-8")
    for _ in range(2):
        assert _run(module, tmp_path).strip() == "5.0"
    kept = list(tmp_path.rglob("*.nbi"))
    assert len(kept) == 1


def test_nowhere_to_keep_the_code_is_no_failure(tmp_path: Path) -> None:
    """As in a container whose file system is read-only and whose user has no home."""
    module = tmp_path / "kernel.py"
    module.write_text(KERNEL, encoding="utf-8")
    only_zip_files = {"NUMBA_CACHE_LOCATOR_CLASSES": "ZipCacheLocator"}
    assert _run(module, tmp_path, **only_zip_files).strip() == "5.0"
    assert not list(tmp_path.rglob("*.nbi"))


def _run(module: Path, folder: Path, **settings: str) -> str:
    root = str(Path(__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": root, "PYTHONDONTWRITEBYTECODE": "1", **settings}
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, str(module)], cwd=folder, env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout
