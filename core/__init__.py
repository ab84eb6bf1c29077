"""Gridpose's numerics: arrays and bytes in, values out; no service, file, clock or log.

The public functions: `calibrate_image` for one image; `calibrate_session`, `assess_repeatability` and `identify_robot`
for the images of a session (docs/python.md).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from core.calibration import Calibration, Lens, calibrate_points
from core.errors import Advisory, GridposeError
from core.geometry import Camera
from core.pipeline import TargetOutcome, calibrate_image, calibrate_targets
from core.targets import GridPoints, TargetSpec

if TYPE_CHECKING:
    from core.kinematics import Chain
    from core.session import (
        CalibratedSession,
        CommandedPose,
        TaggedImage,
        assess_repeatability,
        calibrate_session,
        identify_robot,
    )

__all__ = [
    "Advisory",
    "CalibratedSession",
    "Calibration",
    "Camera",
    "Chain",
    "CommandedPose",
    "GridPoints",
    "GridposeError",
    "Lens",
    "TaggedImage",
    "TargetOutcome",
    "TargetSpec",
    "assess_repeatability",
    "calibrate_image",
    "calibrate_points",
    "calibrate_session",
    "calibrate_targets",
    "identify_robot",
]
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """Load what is computed of sessions when it is first used: it takes longer to load than all the rest."""
    if name == "Chain":
        from core.kinematics import Chain

        return Chain
    if name in __all__:
        from core import session

        return getattr(session, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
