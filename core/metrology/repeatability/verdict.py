"""Verdict on a figure, by its noise floor: it measures the robot, or mostly the instrument."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

FEW_CYCLES = 10


class Verdict(StrEnum):
    """What a figure measures: the robot, mostly the instrument, nothing yet, a motion over the session, or too little
    to say.
    """

    ROBOT = "robot"
    INSTRUMENT_LIMITED = "instrument_limited"
    BELOW_DETECTION = "below_detection"
    NOT_STEADY = "not_steady"
    TOO_FEW_CYCLES = "too_few_cycles"


@dataclass(frozen=True, slots=True)
class VerdictLimits:
    """Limits of the verdict `robot`: ratios of the noise floor and the reading, both without unit.

    `instrument_share`: a floor above this share of the reading makes it instrument limited (at .25 the instrument adds
    about 3 % to the reading). `detection_share`: a reading below this share of the floor is less than the stated
    measurement noise alone would give, by more than chance.
    """

    instrument_share: float = 0.25
    detection_share: float = 0.75


def classify(reading: float, floor: float | None, cycles: int, limits: VerdictLimits) -> Verdict:
    """Return what a reading measures, given the floor that n cycles have; None where nothing is known of the noise.

    A check that cannot be made does not pass: without a floor no verdict is `robot`.
    """
    if cycles < FEW_CYCLES:
        return Verdict.TOO_FEW_CYCLES
    if reading == 0.0 or (floor is not None and reading < limits.detection_share * floor):
        return Verdict.BELOW_DETECTION
    if floor is None:
        return Verdict.INSTRUMENT_LIMITED
    return Verdict.INSTRUMENT_LIMITED if floor > limits.instrument_share * reading else Verdict.ROBOT
