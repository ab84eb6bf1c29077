"""Values in another unit than their names say (metres, radians), and joint angles of another number than the joints."""

from app.services.plausibility.joint_numbers import require_joints
from app.services.plausibility.readings import check_readings
from app.services.plausibility.stated_values import (
    MAX_PARALLEL,
    check_certificate,
    check_commands,
    check_datasheet,
    check_intrinsics,
    check_joints,
    check_lens,
    check_pitch,
)
from app.services.plausibility.uncertainties import check_pitch_uncertainty

__all__ = [
    "MAX_PARALLEL",
    "check_certificate",
    "check_commands",
    "check_datasheet",
    "check_intrinsics",
    "check_joints",
    "check_lens",
    "check_pitch",
    "check_pitch_uncertainty",
    "check_readings",
    "require_joints",
]
