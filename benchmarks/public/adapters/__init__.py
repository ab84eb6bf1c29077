"""Detectors behind two functions each, and how they are found: by name in this folder, or as a file.

    def prepare(target) -> Any | None     # once for each target, not timed; None: this detector has no such target
    def detect(prepared, image) -> (labels, points_px)    # timed; image (h, w) uint8

`labels` are whole numbers: `row * columns + column` of a grid point (of an AprilGrid's tag corners, with twice its
columns), and of a ChArUco board's markers `columns * rows + 4 * id + k`, k clockwise from the upper left. `points_px`
(n, 2) has u right, v down, (0, 0) at the centre of the upper left pixel. Nothing found: both empty.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

BUILT_IN = ("opencv_classic", "opencv_sb", "opencv_charuco", "opencv_aruco", "pupil_apriltags", "gridpose")
Found = tuple[np.ndarray, np.ndarray]
NOTHING: Found = (np.zeros(0, np.intp), np.zeros((0, 2)))


class NotInstalled(Exception):
    """A package that the adapter needs is absent; the message says how to install it."""


@dataclass(frozen=True, slots=True)
class Adapter:
    """A detector: its name and its two functions."""

    name: str
    prepare: Callable[[Any], Any]
    detect: Callable[[Any, np.ndarray], Found]


def load(name: str) -> Adapter:
    """Return the adapter of this name, or the one in the file of this path.

    Raises ValueError for a name that is not known, and where it lacks one of the two functions.
    """
    if name in BUILT_IN:
        module = importlib.import_module(f"{__name__}.{name}")
    else:
        path = Path(name)
        if path.suffix != ".py" or not path.is_file():
            raise ValueError(
                f"No adapter {name!r}: use one of {', '.join(BUILT_IN)}, or the path of a .py file."
            )
        spec = importlib.util.spec_from_file_location(path.stem, path)
        assert spec is not None
        assert spec.loader is not None  # of a .py file there always is one
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    for function in ("prepare", "detect"):
        if not callable(getattr(module, function, None)):
            raise ValueError(
                f"The adapter {name!r} has no function {function}; see benchmarks/public/README.md."
            )
    return Adapter(name if name in BUILT_IN else Path(name).stem, module.prepare, module.detect)
