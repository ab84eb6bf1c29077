"""Qualification of a session's camera, lens and target by known lengths between its poses."""

from __future__ import annotations

from collections.abc import Sequence

from core.errors import InvalidArgument, listed
from core.metrology import KnownLength, Qualification, qualify
from core.session.estimate import SessionEstimate
from core.session.model import SessionData
from core.session.repeatability import image_rows, measured_rows
from core.session.visits import cycles_of


def qualify_session(
    data: SessionData,
    estimate: SessionEstimate | None,
    lengths: Sequence[KnownLength],
    maximum_permissible_error_mm: float | None = None,
) -> Qualification:
    """Compare calibrated lengths between poses with what the session measured.

    `estimate` None: the poses that another instrument measured. Raises InvalidArgument for a pose that was not
    measured, or that shows another target than the pose at the other end.
    """
    rows = (measured_rows(data) if estimate is None else image_rows(data, estimate)).rows
    visits = {row.pose_id: row.visits for row in rows if row.visits}
    named = {pose_id for one in lengths for pose_id in (one.from_pose_id, one.to_pose_id)}
    if missing := sorted(named - visits.keys()):
        raise InvalidArgument(
            f"Nothing that counts was measured at {'pose' if len(missing) == 1 else 'poses'} {listed(missing)}.",
            "Name poses of the session whose images count.",
        )
    for one in lengths:
        if visits[one.from_pose_id][0].frame != visits[one.to_pose_id][0].frame:
            raise InvalidArgument(
                f"Poses {one.from_pose_id} and {one.to_pose_id} show different targets, whose places to one another "
                "are not known.",
                "Name poses that show the same target.",
            )
    cycles = {pose_id: cycles_of(visits[pose_id]) for pose_id in named}
    return qualify(
        [(one, cycles[one.from_pose_id], cycles[one.to_pose_id]) for one in lengths],
        maximum_permissible_error_mm,
    )
