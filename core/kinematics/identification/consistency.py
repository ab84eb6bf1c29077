"""Whether poses follow from their joint angles at all: how far they scatter about the best arm."""

from __future__ import annotations

import math

from core.errors import JointAnglesInconsistent
from core.kinematics.dh import Chain
from core.kinematics.global_fit import FitResult
from core.kinematics.identification.sliding_joints import check_sliding
from core.kinematics.joint_angle_checks import check_angles
from core.kinematics.pose_observations import PoseData
from core.kinematics.sweeps import find_sweeps

MAX_RELATIVE_SCATTER = 0.005
"""Of the start's length: poses that scatter by more about the best arm are not this arm's."""
MAX_ROTATION_SCATTER = math.radians(5.0)
"""The same of orientations; arms that miss theirs by a degree are defective."""


def require_consistent(refined: FitResult, length_mm: float, poses: PoseData, nominal: Chain | None) -> None:
    """Raise what is wrong with the joint angles where the poses scatter too far about the arm that fits them best.

    Raises JointAnglesInconsistent; what `check_angles` and `check_sliding` raise where they find the reason.
    """
    spread, turn = refined.scatter.deviations
    turned = poses.rotations is not None and turn > MAX_ROTATION_SCATTER
    conventions = (
        "the convention of the orientations: of the tool in the base, not of the base in the tool, and which Euler "
        "angles or order of a quaternion they were made from."
    )
    if spread > MAX_RELATIVE_SCATTER * length_mm:
        check_angles(poses, find_sweeps(poses))
        if nominal is not None:
            check_sliding(poses, nominal)
        raise JointAnglesInconsistent(
            f"The poses do not follow from their joint angles: about the best arm with {poses.joints} joints they "
            f"scatter by {spread:.3g} mm.",
            "Check the order, signs and unit of the joint angles, that each belongs to its pose, the nominal's "
            "offsets, and that every joint whose angle is not stated rested, as one that slides has to"
            + (f"; check {conventions}" if turned else "."),
        )
    if turned:
        raise JointAnglesInconsistent(
            "The poses' positions follow from their joint angles, their orientations do not: about the best arm they "
            f"scatter by {math.degrees(turn):.2g}°.",
            f"Check {conventions}",
        )
