"""Pose accuracy against the commanded poses, whatever measured the poses: which poses can be compared, in which of
two ways, and which cannot.

Frames are tied by the poses that were commanded whole, where these are at least half of all or enough to detect a wrong
one among them: that of the measuring device on the flange and that of what it measures against in the base. A pose
whose position alone was commanded is compared in the frames that they tie, and poses measured without orientation are
tied by themselves. Where too few were commanded whole, or these do not tie the frames (the standard's cube has one
orientation), positions alone do; orientations then compare with the mean one where one was commanded for all, and else
the poses that lose the accuracy of their orientation are named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from core.calibration import MIN_POSES_TO_REJECT
from core.errors import Advisory, GridposeError, listed
from core.metrology import CycleProcess, PoseAccuracy
from core.session.commanded_poses.equal_commands import distinct_commands
from core.session.commanded_poses.frame_ties import by_positions, by_whole_poses
from core.session.commanded_poses.pose_arrays import Commands, Visits, one_orientation, oriented
from core.session.commanded_poses.units import contradicted_unit
from core.session.model import CameraMount, CommandedPose, MeasuredPose, SessionData, natural

FEW_DEGREES_OF_FREEDOM = 5.0
"""Below so many, an interval of AP is wider than its figure."""

MIN_ROTATION = math.radians(1.0)
"""Commanded orientations within this of one another tie no frames."""
SCALE_MISMATCHES = frozenset({"print_scale_mismatch", "instrument_scale_mismatch"})
"""Warnings that commanded and measured distances differ by one factor: deviations then are not the robot's alone."""


@dataclass(frozen=True, slots=True)
class Accuracy:
    """AP by pose for those that could be compared, and what to know of it."""

    poses: Mapping[str, PoseAccuracy]
    warnings: tuple[Advisory, ...]


def assess_accuracy(
    data: SessionData, visits: Mapping[str, Sequence[MeasuredPose]], process: CycleProcess | None = None
) -> Accuracy:
    """Compare the mean of every pose's visits, which follow `process`, with what was commanded.

    Poses that were measured in different frames are tied by themselves; all visits of one pose are in one frame. A
    warning names the commanded positions that cannot be compared.
    """
    commands = {pose_id: c for pose_id, c in data.commanded.items() if c.position_mm is not None}
    if not any(pose_id in commands for pose_id in visits):
        return _unavailable(
            "The poses' commanded positions are not known.",
            "PUT the session's poses with what was commanded.",
        )
    frames = {pose_id: of_pose[0].frame for pose_id, of_pose in visits.items()}
    of_images = any(visit.image is not None for of_pose in visits.values() for visit in of_pose)
    mount = data.camera_mount if of_images else None
    found: dict[str, PoseAccuracy] = {}
    warnings: list[Advisory] = []
    failures: dict[int, GridposeError] = {}
    in_other_unit = contradicted_unit(visits, data.commanded) is not None  # `units_contradict` says so.
    without = {pose_id: "no measurement of it counts" for pose_id in commands if pose_id not in frames}
    for frame in sorted(set(frames.values())):
        of_frame = {p: commands[p] for p in visits if frames[p] == frame and p in commands}
        if not of_frame:
            continue
        try:
            accuracy = _compare(visits, of_frame, process, mount)
        except GridposeError as failure:
            failures[frame] = failure
            without |= {pose_id: failure.detail.rstrip(".") for pose_id in of_frame}
            continue
        found |= accuracy.poses
        warnings += [
            warning
            for warning in accuracy.warnings
            if warning not in warnings and not (in_other_unit and warning.code in SCALE_MISMATCHES)
        ]
        without |= {p: _why_not(visits[p], commands[p]) for p in of_frame if p not in found}
    if not found:
        most = max(failures, key=lambda frame: (list(frames.values()).count(frame), -frame))
        return _unavailable(failures[most].detail, failures[most].advice)
    return Accuracy(found, (*warnings, *_limits(found, commands), *_incomplete(without)))


def _compare(
    visits: Visits, commands: Commands, process: CycleProcess | None, mount: CameraMount | None
) -> Accuracy:
    """Compare in the better of the two ways that gives an answer. Where neither does, the first failure counts; of
    poses of one orientation that of positions does.
    """
    whole = [p for p, c in commands.items() if c.rotation() is not None and oriented(visits[p])]
    if not whole:
        return _by_positions(visits, commands, process)
    tying = distinct_commands({p: commands[p] for p in whole})
    if tying >= MIN_POSES_TO_REJECT or 2 * tying >= distinct_commands(commands):
        try:
            return _by_poses(visits, commands, process, mount)
        except GridposeError as failure:
            try:
                return _by_positions_instead(visits, commands, process, whole, failure.detail)
            except GridposeError:
                if one_orientation({p: commands[p] for p in whole}, MIN_ROTATION):
                    raise  # Nothing was to be had of whole poses.
                raise failure from None
    try:
        few = f"they are fewer than half of the poses, and than {MIN_POSES_TO_REJECT}"
        return _by_positions_instead(visits, commands, process, whole, few)
    except GridposeError as failure:
        try:
            return _by_poses(visits, commands, process, mount)
        except GridposeError:
            raise failure from None


def _by_poses(
    visits: Visits, commands: Commands, process: CycleProcess | None, mount: CameraMount | None
) -> Accuracy:
    """Compare by whole poses; those measured without orientation by themselves, where they suffice for that."""
    accuracy = Accuracy(*by_whole_poses(visits, commands, process, mount))
    rest = {pose_id: c for pose_id, c in commands.items() if pose_id not in accuracy.poses}
    if not rest:
        return accuracy
    try:
        apart = _by_positions(visits, rest, process)
    except GridposeError:
        return accuracy  # `assess_accuracy` names them.
    return Accuracy({**accuracy.poses, **apart.poses}, (*accuracy.warnings, *apart.warnings))


def _by_positions(visits: Visits, commands: Commands, process: CycleProcess | None) -> Accuracy:
    return Accuracy(*by_positions(visits, commands, process))


def _by_positions_instead(
    visits: Visits, commands: Commands, process: CycleProcess | None, whole: Sequence[str], reason: str
) -> Accuracy:
    """Compare by positions poses whose orientation was commanded and measured all the same, and say what that costs."""
    accuracy = _by_positions(visits, commands, process)
    lost = [p for p in whole if p in accuracy.poses and accuracy.poses[p].rotation is None]
    if lost:
        warning = Advisory(
            "orientation_accuracy_unavailable",
            f"The frames are tied by positions alone, so {listed(sorted(lost, key=natural))} "
            f"{'has' if len(lost) == 1 else 'have'} no accuracy of orientation, though it was commanded and measured: "
            f"{reason.rstrip('.')}.",
            f"State the commanded orientations of {MIN_POSES_TO_REJECT} poses or more that turn about two axes.",
        )
    else:
        warning = Advisory(
            "orientation_accuracy_about_mean",
            "All poses have one commanded orientation, so the frames are tied by positions. Accuracy of orientation "
            "is against the poses' mean orientation: a turn that all poses share is not observable.",
            f"Add {MIN_POSES_TO_REJECT} poses or more that turn about two axes to tie the orientation as well.",
        )
    return Accuracy(accuracy.poses, (warning, *accuracy.warnings))


def _limits(found: Mapping[str, PoseAccuracy], commands: Commands) -> list[Advisory]:
    """Say where few poses tie the frames, and where angles mean nothing."""
    warnings = []
    least = min(one.degrees_of_freedom for one in found.values())
    count = distinct_commands({p: commands[p] for p in found})
    if least < FEW_DEGREES_OF_FREEDOM:
        warnings.append(
            Advisory(
                "accuracy_weakly_determined",
                f"The {count} poses tie the frames with {least:.1f} degrees of freedom to spare: so few "
                "leave the figures of accuracy uncertain by about their own size.",
                "Add poses: five of one commanded orientation leave nine degrees of freedom, ten of any 24.",
            )
        )
    singular = sorted((p for p, one in found.items() if one.near_singularity), key=natural)
    if singular:
        warnings.append(
            Advisory(
                "accuracy_near_gimbal_lock",
                f"Commanded pitch is within 5° of ±90° at {listed(singular)}: roll, pitch and yaw do not describe "
                "small turns there, and accuracy of orientation is given as a rotation vector alone.",
                "Judge orientation at these poses by the rotation vector.",
            )
        )
    return warnings


def _why_not(visits: Sequence[MeasuredPose], commanded: CommandedPose) -> str:
    if oriented(visits):
        return "its orientation was not commanded, and it cannot be compared with those whose was"
    if commanded.rotation() is None:
        return "its orientation was not commanded, and not all of its readings have one"
    return "not all of its readings have an orientation, and such poses do not tie frames by themselves"


def _incomplete(without: Mapping[str, str]) -> list[Advisory]:
    """Name the poses that got no accuracy, by reason."""
    reasons: dict[str, list[str]] = {}
    for pose_id in sorted(without, key=natural):
        reasons.setdefault(without[pose_id], []).append(pose_id)
    if not reasons:
        return []
    found = "; ".join(f"{listed(pose_ids)}: {reason}" for reason, pose_ids in sorted(reasons.items()))
    return [
        Advisory(
            "accuracy_incomplete",
            f"{'One pose has' if len(without) == 1 else f'{len(without)} poses have'} a commanded position and no "
            f"accuracy. {found}.",
            "State the commanded orientations of all poses, and give poses before another target enough of their own "
            "that turn about two axes.",
        )
    ]


def _unavailable(reason: str, advice: str | None) -> Accuracy:
    """Return that nothing could be compared, and why."""
    return Accuracy({}, (Advisory("accuracy_unavailable", f"Accuracy is not given: {reason}", advice),))
