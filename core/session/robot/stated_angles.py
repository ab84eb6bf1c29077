"""The joint angles that poses of a session state, and what is said of those that cannot be used."""

from __future__ import annotations

from collections.abc import Sequence

from core.errors import Advisory, JointAnglesInconsistent, listed
from core.session.estimate import ExcludedMeasurement
from core.session.model import MeasuredPose, SessionData

_NO_ANGLES = "Neither it nor its pose has joint angles."
_WRONG_NUMBER = "Its joint angles are not as many as the robot's joints."


def angles_of(data: SessionData, pose: MeasuredPose) -> Sequence[float] | None:
    """Return the joint angles (deg) of a pose; None where it has none, or not as many as the robot has joints."""
    stated = _stated(data, pose)
    odd = stated is not None and data.nominal is not None and len(stated) != len(data.nominal)
    return None if odd else stated


def refuse_wrong_numbers(data: SessionData, poses: Sequence[MeasuredPose]) -> None:
    """Raise JointAnglesInconsistent where poses state joint angles, of which none can be used."""
    numbers = sorted({len(stated) for pose in poses if (stated := _stated(data, pose))})
    if numbers and data.nominal is not None and len(data.nominal) not in numbers:
        found = ", ".join(str(number) for number in numbers)
        raise JointAnglesInconsistent(
            f"Poses carry {found} joint angles; the robot has {len(data.nominal)} joints."
        )


def excluded_for_angles(data: SessionData, pose: MeasuredPose) -> ExcludedMeasurement:
    """Return a pose without usable joint angles as an excluded one."""
    if _stated(data, pose):
        return ExcludedMeasurement(pose.measurement_id, "joint_angles_inconsistent", _WRONG_NUMBER)
    return ExcludedMeasurement(pose.measurement_id, "joint_angles_missing", _NO_ANGLES)


def without_angles(data: SessionData, poses: Sequence[MeasuredPose], used: frozenset[str]) -> list[Advisory]:
    """Return warnings of poses without usable joint angles; of those without any, but for pose ids that are used."""
    missing = sorted({pose.pose_id for pose in poses if not _stated(data, pose)} - used)
    odd = sorted({pose.pose_id for pose in poses if _stated(data, pose)})
    return [
        *excluded_poses(missing, "joint_angles_missing"),
        *excluded_poses(
            odd, "joint_angles_inconsistent", "with another number of joint angles than the robot has joints"
        ),
    ]


def _stated(data: SessionData, pose: MeasuredPose) -> Sequence[float] | None:
    """Return the pose's own joint angles (deg), or else those commanded."""
    if pose.joint_angles_deg is not None:
        return pose.joint_angles_deg
    commanded = data.commanded.get(pose.pose_id)
    return commanded.joint_angles_deg if commanded is not None else None


def excluded_poses(pose_ids: Sequence[str], code: str, what: str = "without joint angles") -> list[Advisory]:
    """Return a warning that poses are excluded, and why; none without poses."""
    if not pose_ids:
        return []
    return [
        Advisory(
            code,
            f"Poses {what} are excluded: {listed(pose_ids)}.",
            "Correct these, one angle for each joint of the robot, and the poses count."
            if code == "joint_angles_inconsistent"
            else "Send what is missing, and the poses count.",
        )
    ]
