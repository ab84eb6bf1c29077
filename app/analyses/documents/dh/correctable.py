"""The warning of an arm with too few axes for all six components of its errors, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from core import Advisory
from core.kinematics import CorrectableComponents, Corrected


def partial_correction(corrected: Corrected, known: Sequence[bool]) -> tuple[Advisory, ...]:
    """Return the warning `correction_partial`; none where the arm corrects all six components.

    `known` says of which commands the joint angles are known.
    """
    components = corrected.components
    if components.complete:
        return ()
    counted = corrected.applied & np.array(known, dtype=np.bool_)
    rest = ""
    if counted.any():
        mm, rad = np.sqrt(np.mean(corrected.left[:, counted] ** 2, axis=1))
        rest = f" What they leave is {mm:.2g} mm and {math.degrees(rad):.2g}° (rms), and counts in expected residuals."
    return (
        Advisory(
            "correction_partial",
            f"The robot's {components.axes} axes correct {components.rank} of the six components of an error, those of "
            f"position first: {_position(components)}, and {_rotation(components)}.{rest}",
            "Where what is left matters, correct it at the tool or in the frame of the work.",
        ),
    )


def _position(components: CorrectableComponents) -> str:
    if components.position == 3:
        return "the whole position"
    axis = components.base_axis
    where = "" if axis is None else f" (not along {'xyz'[axis]} of the base)"
    return f"{components.position} of 3 of the position{where}"


def _rotation(components: CorrectableComponents) -> str:
    return "no rotation" if components.rotation == 0 else f"{components.rotation} of 3 of the rotation"
