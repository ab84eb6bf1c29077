"""Pose accuracy against what the robot was told, whatever measured the poses: which poses can be compared, in which of
two ways, and by name which cannot.

Frames are tied by the poses that were commanded whole, where these are at least half of all or enough to tell a wrong
one among them: that of the measuring device on the flange and that of what it measures against in the base. A pose
whose position alone was commanded is compared in the frames that they tie, and poses measured without orientation are
tied by themselves. Where too few were commanded whole, or these do not tie the frames, positions alone do, and the
poses that lose the accuracy of their orientation by that are named.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from app.services.analyses.snapshot import Commanded, Snapshot, natural
from core import Advisory, GridposeError
from core.calibration.hand_eye import Deviation, FrameTie, PositionStation, tie_positions
from core.calibration.hand_eye.tie import LEAST_TO_JUDGE
from core.metrology import Figures, pose_accuracy
from core.transforms import rpy_to_rotation, so3_exp, transform, transform_mean

NAMED = 5

Told = Mapping[str, Commanded]


@dataclass(frozen=True, slots=True)
class Accuracy:
    """AP by pose, mm and rad, for those that could be compared; what to know of it."""

    poses: Mapping[str, Figures[float | None]]
    warnings: tuple[Advisory, ...]


@dataclass(frozen=True, slots=True)
class Ways:
    """How one kind of measurement is compared: by whole poses, where `oriented` says that a pose's measurements have an
    orientation too, or by positions. Either raises GridposeError where the poses do not tie the frames.
    """

    oriented: Callable[[str], bool]
    by_poses: Callable[[Told], Accuracy]
    by_positions: Callable[[Told], Accuracy]


def compare_with_commands(snapshot: Snapshot, frames: Mapping[str, int], ways: Ways) -> Accuracy:
    """Return the accuracy of all poses that can be compared, and name those with a commanded position that cannot.

    `frames` holds the measured poses, each with the number of the frame it was measured in: poses in different frames
    are tied by themselves.
    """
    told = {pose_id: c for pose_id, c in snapshot.commanded.items() if c.position_mm is not None}
    if not any(pose_id in told for pose_id in frames):
        return unavailable(
            "The poses' commanded positions are not known.",
            "PUT the session's poses with what was commanded.",
        )
    found: dict[str, Figures[float | None]] = {}
    warnings: list[Advisory] = []
    failures: dict[int, GridposeError] = {}
    without = {pose_id: "no measurement of it counts" for pose_id in told if pose_id not in frames}
    for frame in sorted(set(frames.values())):
        of_frame = {
            pose_id: told[pose_id] for pose_id in frames if frames[pose_id] == frame and pose_id in told
        }
        if not of_frame:
            continue
        try:
            accuracy = _compare(of_frame, ways)
        except GridposeError as failure:
            failures[frame] = failure
            without |= {pose_id: failure.detail.rstrip(".") for pose_id in of_frame}
            continue
        found |= accuracy.poses
        warnings += [warning for warning in accuracy.warnings if warning not in warnings]
        without |= {
            pose_id: _why_not(told[pose_id], ways.oriented(pose_id))
            for pose_id in of_frame
            if pose_id not in found
        }
    if not found:
        most = max(failures, key=lambda frame: (list(frames.values()).count(frame), -frame))
        return unavailable(failures[most].detail, failures[most].advice)
    return Accuracy(found, (*warnings, *_incomplete(without)))


def _compare(told: Told, ways: Ways) -> Accuracy:
    """Compare in the better of the two ways that gives an answer; the first failure counts where neither does."""
    whole = [
        pose_id for pose_id, c in told.items() if commanded_rotation(c) is not None and ways.oriented(pose_id)
    ]
    if not whole:
        return ways.by_positions(told)
    if len(whole) >= LEAST_TO_JUDGE or 2 * len(whole) >= len(told):
        try:
            return _by_poses(told, ways)
        except GridposeError as failure:
            if len(whole) == len(told):
                raise
            try:
                return _without_orientation(ways.by_positions(told), whole, failure.detail)
            except GridposeError:
                raise failure from None
    try:
        few = f"they are fewer than half of the poses, and than {LEAST_TO_JUDGE}"
        return _without_orientation(ways.by_positions(told), whole, few)
    except GridposeError as failure:
        try:
            return _by_poses(told, ways)
        except GridposeError:
            raise failure from None


def _by_poses(told: Told, ways: Ways) -> Accuracy:
    """Compare by whole poses; those measured without orientation by themselves, where they suffice for that."""
    accuracy = ways.by_poses(told)
    rest = {pose_id: c for pose_id, c in told.items() if pose_id not in accuracy.poses}
    if not rest:
        return accuracy
    try:
        apart = ways.by_positions(rest)
    except GridposeError:
        return accuracy  # `compare_with_commands` names them.
    return Accuracy({**accuracy.poses, **apart.poses}, (*accuracy.warnings, *apart.warnings))


def _without_orientation(accuracy: Accuracy, whole: Sequence[str], reason: str) -> Accuracy:
    """Return an accuracy of positions with the remark whose orientation was commanded and measured all the same."""
    remark = Advisory(
        "orientation_accuracy_unavailable",
        f"The frames are tied by positions alone, so {_listed(sorted(whole, key=natural))} "
        f"{'has' if len(whole) == 1 else 'have'} no accuracy of orientation, though it was commanded and measured: "
        f"{reason.rstrip('.')}.",
        f"State the commanded orientations of {LEAST_TO_JUDGE} poses or more that turn about two axes.",
    )
    return Accuracy(accuracy.poses, (remark, *accuracy.warnings))


def _why_not(commanded: Commanded, oriented: bool) -> str:
    if oriented:
        return "its orientation was not commanded, and it cannot be compared with those whose was"
    if commanded_rotation(commanded) is None:
        return "its orientation was not commanded, and not all of its readings have one"
    return "not all of its readings have an orientation, and such poses do not tie frames by themselves"


def _incomplete(without: Mapping[str, str]) -> list[Advisory]:
    """Name the poses that got no accuracy, by reason."""
    reasons: dict[str, list[str]] = {}
    for pose_id in sorted(without, key=natural):
        reasons.setdefault(without[pose_id], []).append(pose_id)
    if not reasons:
        return []
    listed = "; ".join(f"{_listed(pose_ids)}: {reason}" for reason, pose_ids in sorted(reasons.items()))
    return [
        Advisory(
            "accuracy_incomplete",
            f"{'One pose has' if len(without) == 1 else f'{len(without)} poses have'} a commanded position and no "
            f"accuracy. {listed}.",
            "State the commanded orientations of all poses, and give poses before another target enough of their own "
            "that turn about two axes.",
        )
    ]


def _listed(pose_ids: Sequence[str]) -> str:
    more = f" and {len(pose_ids) - NAMED} more" if len(pose_ids) > NAMED else ""
    return f"{', '.join(pose_ids[:NAMED])}{more}"


def unavailable(reason: str, advice: str | None) -> Accuracy:
    """Return that nothing could be compared, and why."""
    return Accuracy({}, (Advisory("accuracy_unavailable", f"Accuracy is not given: {reason}", advice),))


def commanded_rotation(commanded: Commanded) -> Float[np.ndarray, "3 3"] | None:
    """Return how the robot was told to turn its flange; None where that is not known whole."""
    angles = (commanded.roll_deg, commanded.pitch_deg, commanded.yaw_deg)
    if any(angle is None for angle in angles):
        return None
    return rpy_to_rotation(np.radians(np.array(angles, dtype=np.float64)))


def commanded_pose(commanded: Commanded) -> Float[np.ndarray, "4 4"]:
    """Return T_base_flange as commanded; unturned where the orientation is not known."""
    rotation = commanded_rotation(commanded)
    return transform(
        np.eye(3) if rotation is None else rotation, np.array(commanded.position_mm, dtype=np.float64)
    )


def of_tie(tie: FrameTie, told: Told, others: Mapping[str, Float[np.ndarray, "n 4 4"]]) -> Accuracy:
    """Return AP in tied frames; `others` are the measurements of poses whose position alone was commanded."""
    found = {d.pose_id: _compared(d, commanded_pose(told[d.pose_id])) for d in tie.deviations}
    for pose_id, measured in others.items():
        attained = tie.frames.attained(transform_mean(measured)[None])[0]
        found[pose_id] = pose_accuracy(attained[:3, 3], np.array(told[pose_id].position_mm, dtype=np.float64))
    return Accuracy(found, tie.warnings)


def by_measured_orientation(stations: Sequence[PositionStation]) -> Accuracy:
    """Return AP of positions, in frames tied by them and by how each pose was measured to be turned."""
    tie = tie_positions(stations)
    found = {}
    for station, fitted, held_out in zip(stations, tie.deviations_mm, tie.held_out_mm, strict=True):
        attained = station.position_base_mm + (fitted if held_out is None else held_out)
        found[station.pose_id] = pose_accuracy(attained, station.position_base_mm)
    return Accuracy(found, tie.warnings)


def _compared(deviation: Deviation, commanded: Float[np.ndarray, "4 4"]) -> Figures[float | None]:
    """Return AP by the frames that the other poses tie, where they suffice for that."""
    position, turn = deviation.held_out_position_mm, deviation.held_out_rotation
    if position is None or turn is None:
        position, turn = deviation.position_mm, deviation.rotation
    return pose_accuracy(
        commanded[:3, 3] + position, commanded[:3, 3], so3_exp(turn) @ commanded[:3, :3], commanded[:3, :3]
    )
