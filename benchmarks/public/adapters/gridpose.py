"""Gridpose's own detector."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.public.adapters import NOTHING, Found
from core.errors import DetectionError
from core.targets import detect as detect_target


def prepare(target: Any) -> Any | None:
    return target


def detect(prepared: Any, image: np.ndarray) -> Found:
    try:
        found = detect_target(image, prepared)
    except DetectionError:
        return NOTHING
    return found.row * prepared.grid_columns + found.column, found.points_px
