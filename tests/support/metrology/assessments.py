"""What is said of one pose, and the numbers in it."""

from __future__ import annotations

from typing import Any

from core.metrology import PoseCycles, PoseRepeatability, assess_repeatability


def assess(cycles: PoseCycles, **options: Any) -> PoseRepeatability:
    return assess_repeatability([cycles], **options)[0]


def numbers(result: PoseRepeatability) -> list[float]:
    values: list[float] = []
    for figures in (result.repeatability, result.noise_floor, result.corrected):
        values += [value for _, value in figures.items() if value is not None]
    for intervals in (result.interval, result.corrected_interval):
        values += [bound for _, interval in intervals.items() if interval is not None for bound in interval]
    return values
