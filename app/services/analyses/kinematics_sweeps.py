"""The sweeps of an analysis: recognised from joint angles, or where the request names poses, those.

A joint that is named has its named sweeps alone; the others' are recognised.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from app.services.analyses.outcome import CannotAnalyse
from app.services.analyses.snapshot import Snapshot, natural
from app.services.analyses.sweep_names import parsed, sweeps_named
from core import Advisory
from core.kinematics.poses import PoseData
from core.kinematics.sweeps import Sweep, find_sweeps, named_sweeps

_SHOWN = 5


@dataclass(frozen=True, slots=True)
class SessionSweeps:
    """Sweeps, the names that were asked for in their one spelling, and what is to be said of them."""

    sweeps: tuple[Sweep, ...]
    named: tuple[str, ...]
    warnings: tuple[Advisory, ...]


def sweeps_of(
    snapshot: Snapshot, poses: PoseData, settings: Mapping[str, str], tolerance: float
) -> SessionSweeps:
    """Return the sweeps among a session's poses; `tolerance` is in rad.

    Raises CannotAnalyse for a joint or a pose that does not exist, and what `core.kinematics.sweeps.named_sweeps`
    raises where a named sweep is none.
    """
    found = find_sweeps(poses, tolerance=tolerance)
    named = sweeps_named(settings.get("sweeps", "[]"))
    if not named:
        return SessionSweeps(found, (), ())
    of_session = {image.pose_id for image in snapshot.images} | {m.pose_id for m in snapshot.measured}
    serving = frozenset(poses.labels)
    chosen: dict[int, list[tuple[str, ...]]] = {}
    unusable: set[str] = set()
    for name in named:
        joint, patterns = parsed(name)
        if joint > poses.joints:
            raise CannotAnalyse(
                "sweep_joint_unknown",
                f"A sweep is named for joint {joint}; the robot has {poses.joints} joints.",
                "Name a joint by its number, counted from 1 at the base.",
            )
        members = _matching(patterns, of_session)
        unusable |= members - serving
        chosen.setdefault(joint - 1, []).append(tuple(sorted(members & serving, key=natural)))
    sweeps = [s for s in found if s.joint not in chosen]
    sweeps += named_sweeps(poses, chosen, tolerance=tolerance)
    sweeps.sort(key=lambda s: (s.joint, -len(s.poses), int(s.poses[0])))
    return SessionSweeps(tuple(sweeps), named, _said_of(unusable))


def _matching(patterns: Sequence[str], pose_ids: set[str]) -> set[str]:
    """Return the pose IDs that are meant; raises CannotAnalyse for a name or pattern that means none."""
    found: set[str] = set()
    for pattern in patterns:
        if "*" in pattern or "?" in pattern:
            members = {
                pose_id for pose_id in pose_ids if fnmatchcase(pose_id, pattern)
            }  # brackets never come here
            what = "matches"
        else:
            members, what = {pattern} & pose_ids, "is named"
        if not members:
            some = sorted(pose_ids, key=natural)[:_SHOWN]
            raise CannotAnalyse(
                "sweep_pose_unknown",
                f"No measured pose of the session {what} {pattern}; there are {', '.join(some)}"
                f"{', ...' if len(pose_ids) > _SHOWN else ''}.",
                "Name poses by the pose_id of their measurements; * stands for any text, ? for one character.",
            )
        found |= members
    return found


def _said_of(unusable: set[str]) -> tuple[Advisory, ...]:
    if not unusable:
        return ()
    some = sorted(unusable, key=natural)
    return (
        Advisory(
            "sweep_poses_left_out",
            f"{len(some)} poses of named sweeps do not serve and were left out: {', '.join(some[:_SHOWN])}"
            f"{', ...' if len(some) > _SHOWN else ''}.",
            "Their measurements failed, or have no joint angles; the list of measurements says which.",
        ),
    )
