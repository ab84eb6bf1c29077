"""Verdict on a figure, by its noise floor: it measures the robot, or mostly the instrument."""

from __future__ import annotations

from enum import StrEnum

FEW_CYCLES = 10
MAX_INSTRUMENT_SHARE = 0.25
"""Of the reading: with a floor above it the instrument adds more than about 3 % to the reading."""
MIN_DETECTION_SHARE = 0.75
"""Of the floor: a reading below it is less than the stated measurement noise alone would give, by more than chance."""


class Verdict(StrEnum):
    """What a figure measures: the robot, mostly the instrument, nothing yet, a motion over the session, or too little
    to say.
    """

    ROBOT = "robot"
    INSTRUMENT_LIMITED = "instrument_limited"
    BELOW_DETECTION = "below_detection"
    NOT_STEADY = "not_steady"
    TOO_FEW_CYCLES = "too_few_cycles"


def classify(reading: float, floor: float | None, cycles: int) -> Verdict:
    """Return what a reading measures, given the floor that n cycles have; None where nothing is known of the noise.

    A check that cannot be made does not pass: without a floor no verdict is `robot`.
    """
    if cycles < FEW_CYCLES:
        return Verdict.TOO_FEW_CYCLES
    if reading == 0.0 or (floor is not None and reading < MIN_DETECTION_SHARE * floor):
        return Verdict.BELOW_DETECTION
    if floor is None:
        return Verdict.INSTRUMENT_LIMITED
    return Verdict.INSTRUMENT_LIMITED if floor > MAX_INSTRUMENT_SHARE * reading else Verdict.ROBOT
