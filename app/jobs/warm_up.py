"""Compilation of the kernels ahead of the jobs: all of them at the end of an installation, the usual ones in a worker.

`python -m app.jobs.warm_up` compiles every kernel of core for the signatures that it declares, in as many processes
as there are cores, and stores the machine code where `core.code_cache` says. A worker process calls `warm_up` before
its first job: it loads the stored code, or compiles what an image of a chessboard needs where none is stored.
"""

from __future__ import annotations

import importlib
import inspect
import math
import multiprocessing
import os
import pkgutil
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.sharedctypes import Synchronized

import cv2
import numpy as np
from jaxtyping import Float, UInt8

import core
from core import Camera, TargetSpec, calibrate_targets
from core.calibration import estimate_group
from core.geometry import so3_exp
from core.jit import Kernel
from core.targets import GridPoints

CHESSBOARD = TargetSpec("chessboard", 7, 5, pitch_mm=10.0)
_CAMERA = Camera(300.0, 300.0, 159.5, 119.5)
_SIZE_PX = (320, 240)
_AHEAD_MM = np.array([0.0, 0.0, 120.0])
_TILT = so3_exp(np.array([math.radians(35.0), 0.0, 0.1]))
_OTHER_TILT = so3_exp(np.array([0.0, math.radians(35.0), 0.1]))
"""One tilt alone leaves the principal point to its prior, and with it the focal length."""
_PIXELS_PER_SQUARE = 32
_MAX_PROCESSES = 8
"""More processes than this wait for the kernels of `core.targets.subpixel.corner_step`, which take longest."""
_LINE_EVERY_S = 5.0
"""Between lines of progress, where the output is no terminal and the same line cannot be written again."""

_compiled: Synchronized[int]
"""How many signatures all processes have compiled. Set in the processes that `compile_kernels` starts."""


def warm_up() -> None:
    """Calibrate a small board, by the way that every job's image takes, and pool it as analyses do."""
    points, others = (_calibrated_points(_small_image(tilt), CHESSBOARD) for tilt in (_TILT, _OTHER_TILT))
    estimate_group([points, points, others], "pooled", repeats=["home", "home", "other"])


def _small_image(tilt: Float[np.ndarray, "3 3"]) -> UInt8[np.ndarray, "h w"]:
    """Return a small image of the tilted chessboard. A drawing will do: the renderer, and what it loads, is no part of
    a worker.
    """
    squares = (np.indices((CHESSBOARD.rows + 1, CHESSBOARD.columns + 1)).sum(axis=0) % 2).astype(np.uint8)
    pattern = 40 + 160 * np.kron(squares, np.ones((_PIXELS_PER_SQUARE, _PIXELS_PER_SQUARE), np.uint8))
    pattern = np.pad(pattern, _PIXELS_PER_SQUARE, constant_values=200)
    mm = CHESSBOARD.pitch_mm / _PIXELS_PER_SQUARE
    origin = (0.5 - 2 * _PIXELS_PER_SQUARE) * mm  # of the first pixel, from the first grid point
    placed = _AHEAD_MM - tilt @ CHESSBOARD.points_target().mean(axis=0)
    H = (
        _CAMERA.matrix
        @ np.column_stack([tilt[:, 0], tilt[:, 1], placed])
        @ np.array([[mm, 0.0, origin], [0.0, mm, origin], [0.0, 0.0, 1.0]])
    )
    sharp = cv2.warpPerspective(pattern, H, _SIZE_PX, borderMode=cv2.BORDER_CONSTANT, borderValue=200)
    noise = np.random.default_rng(0).normal(0.0, 2.0, sharp.shape)
    return np.clip(cv2.GaussianBlur(sharp, (0, 0), 1.0) + noise, 0.0, 255.0).astype(np.uint8)


def _calibrated_points(image: UInt8[np.ndarray, "h w"], board: TargetSpec) -> GridPoints:
    """Return the grid points of a calibrated image; an installation that cannot do this one can do no other."""
    (outcome,) = calibrate_targets(cv2.imencode(".png", image)[1].tobytes(), [board])
    if outcome.failure is not None:
        raise outcome.failure
    assert outcome.calibration is not None
    return outcome.calibration.points


def kernels_by_module() -> dict[str, list[Kernel]]:
    """Return the kernels of core by the modules that define them."""
    found: dict[str, list[Kernel]] = {}
    for module in pkgutil.walk_packages(core.__path__, "core."):
        for value in vars(importlib.import_module(module.name)).values():
            if isinstance(value, Kernel) and value.__module__ == module.name:
                found.setdefault(module.name, []).append(value)
    return found


def _modules_together(kernels: dict[str, list[Kernel]]) -> list[list[str]]:
    """Return the modules in groups, the longest to compile first: those of one package whose kernels call one another
    are one group.
    """
    group = {module: [module] for module in kernels}
    for module in kernels:
        for value in vars(sys.modules[module]).values():
            other = value.__module__ if isinstance(value, Kernel) else module
            if group[other] is not group[module] and _package(other) == _package(module):
                group[module] += group[other]
                group |= dict.fromkeys(group[other], group[module])
    groups = {id(modules): modules for modules in group.values()}.values()
    return sorted(groups, key=lambda modules: -sum(_weight(k) for m in modules for k in kernels[m]))


def _package(module: str) -> str:
    return module.rpartition(".")[0]


def _weight(kernel: Kernel) -> int:
    return len(inspect.getsource(inspect.unwrap(kernel))) * len(kernel.declared)


def compile_kernels(processes: int) -> None:
    """Compile every kernel for the signatures that it declares, and print the progress.

    Modules whose kernels call one another are compiled in one process. A few small kernels are called from other
    packages, so next to nothing is compiled twice.
    """
    kernels = kernels_by_module()
    total = sum(len(kernel.declared) for of_module in kernels.values() for kernel in of_module)
    spawn = multiprocessing.get_context("spawn")
    compiled = spawn.Value("i", 0)
    progress = _Progress(total)
    with ProcessPoolExecutor(
        processes, mp_context=spawn, initializer=_share_count, initargs=(compiled,)
    ) as pool:
        running = [pool.submit(_compile_modules, group) for group in _modules_together(kernels)]
        while not all(future.done() for future in running):
            progress.show(compiled.value)
            time.sleep(0.1)
        for future in running:
            future.result()
    progress.show(total)


def _share_count(compiled: Synchronized[int]) -> None:
    global _compiled
    _compiled = compiled


def _compile_modules(names: list[str]) -> None:
    for name in names:
        for kernel in vars(importlib.import_module(name)).values():
            if isinstance(kernel, Kernel) and kernel.__module__ == name:
                for signature in kernel.declared:
                    kernel.compile_declared(signature)
                    with _compiled.get_lock():
                        _compiled.value += 1


class _Progress:
    """One line that is written again on a terminal; elsewhere a line every few seconds."""

    def __init__(self, total: int) -> None:
        self._total = total
        self._shown = -1
        self._next_line_at = 0.0

    def show(self, count: int) -> None:
        is_last = count == self._total
        if count == self._shown or (
            not sys.stdout.isatty() and not is_last and time.monotonic() < self._next_line_at
        ):
            return
        self._shown, self._next_line_at = count, time.monotonic() + _LINE_EVERY_S
        begin, end = ("\r", "\n" if is_last else "") if sys.stdout.isatty() else ("", "\n")
        sys.stdout.write(f"{begin}compiling kernels {count} of {self._total}{end}")
        sys.stdout.flush()


if __name__ == "__main__":
    compile_kernels(
        min(
            len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
            _MAX_PROCESSES,
        )
    )
