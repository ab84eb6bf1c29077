"""What it takes that an image becomes a measurement: the rules, in statements that one transaction runs.

The same statements run on SQLite and on PostgreSQL (`records.statements`); whoever asks before the image came asks
with them, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa

from app.errors import InvalidContent, NotFound
from app.jobs.validation import ImageInfo
from app.records.activity import maker, note_objects
from app.records.ids import is_id, new_id
from app.records.statements import Rows, Statement
from app.records.tables import Measurement, Pose, Session, SessionTarget
from app.services.installation.context import ServiceContext
from app.services.measurements.quota import count_upload
from app.services.plausibility import require_joints
from app.services.poses import ensure_pose
from app.services.queries import NOUNS, may_see_session

_MEASUREMENTS = Measurement.__table__
_OF_IMAGE = (
    _MEASUREMENTS.c.session_id == sa.bindparam("session_id"),
    _MEASUREMENTS.c.pose_id == sa.bindparam("pose_id"),
    _MEASUREMENTS.c.sha256 == sa.bindparam("sha256"),
)
_SELECT_TARGETS = (
    sa.select(Session.id, SessionTarget.target_id)
    .outerjoin(SessionTarget, SessionTarget.session_id == Session.id)
    .where(Session.id == sa.bindparam("session_id"))
    .order_by(SessionTarget.position)
)
_TARGETS = Statement(_SELECT_TARGETS)
_TARGETS_OF_LOCKED = Statement(_SELECT_TARGETS.with_for_update(key_share=True, of=Session))
_SAME = Statement(
    sa.select(_MEASUREMENTS.c.id).where(
        *_OF_IMAGE,
        sa.or_(
            sa.and_(_MEASUREMENTS.c.seeks_target, sa.bindparam("unnamed", type_=sa.Boolean())),
            _MEASUREMENTS.c.target_id == sa.bindparam("target_id"),
        ),
    )
)
_SIBLINGS = Statement(sa.select(_MEASUREMENTS.c.id).where(*_OF_IMAGE))
_KNOWN = Statement(
    sa.select(
        sa.exists().where(_MEASUREMENTS.c.sha256 == sa.bindparam("sha256")),
        sa.exists().where(
            Pose.session_id == sa.bindparam("session_id"), Pose.pose_id == sa.bindparam("pose_id")
        ),
    )
)
"""Whether any measurement is of this original, and whether the session knows the pose."""
_COLUMNS = (
    *("id", "session_id", "pose_id", "target_id", "seeks_target", "stated_target_id", "cycle", "burst"),
    *("focus_group", "joint_angles_deg", "captured_at", "received_at", "sha256", "filename", "pose_label"),
    *("bytes", "image_format", "image_width_px", "image_height_px", "status", "attempts", "made_by"),
)
_ADD = Statement(sa.insert(Measurement), _COLUMNS)


@dataclass(frozen=True, slots=True, kw_only=True)
class Metadata:
    """What a client says about an image; all of it optional."""

    cycle: int | None = None
    burst: int = 1
    target_id: str | None = None
    focus_group: str = "default"
    joint_angles_deg: list[float] | None = None
    captured_at: datetime | None = None
    filename: str | None = None
    pose_label: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ReceivedImage:
    """An image that was received whole, and what its header says."""

    session_id: str
    pose_id: str
    sha256: str
    size: int
    header: ImageInfo
    filename: str | None


@dataclass(frozen=True, slots=True)
class TargetChoice:
    """Which target an upload is of, None where the image is to be searched first, and whether the upload named it."""

    target_id: str | None
    named: bool


@dataclass(frozen=True, slots=True)
class NewMeasurement:
    """A measurement that an upload made: its row by columns, and the ids of the others of the same image at the pose.

    `elsewhere`: other measurements name the same original.
    """

    row: dict[str, Any]
    siblings: list[str]
    elsewhere: bool

    @property
    def id(self) -> str:
        """The measurement's id."""
        return str(self.row["id"])


def session_targets(installation: ServiceContext, session_id: str) -> tuple[str, ...]:
    """Return the ids of a session's targets, in its order. Raises NotFound."""
    targets = recall_targets(installation, session_id)
    if targets is not None:
        return targets
    facts = installation.access.current()
    with installation.database.read_rows() as rows:
        targets = read_targets(rows, session_id)
    if facts is not None:
        facts.targets[session_id] = targets
    return targets


def recall_targets(installation: ServiceContext, session_id: str) -> tuple[str, ...] | None:
    """Return the same as far as it is known without asking the database, else None; waits for nothing.

    Raises NotFound for a session that the caller's key may not see.
    """
    _require_visible(session_id)
    facts = installation.access.current()
    return facts.targets.get(session_id) if facts is not None else None


def read_targets(rows: Rows, session_id: str, *, lock: bool = False) -> tuple[str, ...]:
    """Return the ids of a session's targets, in its order; `lock` lets its other writers wait. Raises NotFound."""
    _require_visible(session_id)
    found = rows.all(_TARGETS_OF_LOCKED if lock else _TARGETS, session_id=session_id)
    if not found:
        raise NotFound.of(NOUNS[Session])
    return tuple(target_id for _, target_id in found if target_id is not None)


def choose_target(target_ids: Sequence[str], target_id: str | None) -> TargetChoice:
    """Return which target an upload to a session with these targets is of. Raises InvalidContent."""
    if target_id is None:
        return TargetChoice(target_ids[0] if len(target_ids) == 1 else None, named=False)
    if target_id not in target_ids:
        raise unknown_target([("target_id", "is not one of the session's targets")])
    return TargetChoice(target_id, named=True)


def unknown_target(errors: Sequence[tuple[str, str]]) -> InvalidContent:
    """Return the refusal of targets that a session does not look at."""
    return InvalidContent(
        "The session does not look at this target.",
        "Send one of the session's target_ids, or add the target to them (PATCH /v1/sessions/{session_id}, "
        "`gridpose sessions change`).",
        code="referenced_target_not_found",
        errors=errors,
    )


def require_cycle(cycle: int | None, burst: int | None) -> None:
    """Refuse the place of an image within a stop that nothing names. Raises InvalidContent."""
    if cycle is None and burst is not None and burst > 1:
        raise InvalidContent(
            "A burst is the images of one stop, and the pose and its cycle name the stop.",
            "State the cycle with the burst index, or leave the burst index away, which is 1 then.",
            code="burst_without_cycle",
            errors=[("burst", "is above 1 without a cycle")],
        )


def stored_burst(burst: int | None) -> int | None:
    """Return a burst index as it is stored: that of a stop's first image, 1, is what an image has without one."""
    return burst if burst is not None and burst > 1 else None


def find_same(rows: Rows, session_id: str, pose_id: str, sha256: str, intended: TargetChoice) -> str | None:
    """Return the measurement that the same upload led to: of this target; or of none named, then as now."""
    same = rows.all(
        _SAME,
        session_id=session_id,
        pose_id=pose_id,
        sha256=sha256,
        unnamed=not intended.named,
        target_id=intended.target_id,
    )
    return min((measurement_id for (measurement_id,) in same), default=None)


def accept(rows: Rows, image: ReceivedImage, metadata: Metadata) -> NewMeasurement | str:
    """Add the measurement of a received image, whose file is in place; or return the id of the one that is there.

    The session's targets are read again: they may have changed while the image came. Raises NotFound, InvalidContent,
    QuotaExceeded.
    """
    session_id, pose_id, sha256 = image.session_id, image.pose_id, image.sha256
    intended = choose_target(read_targets(rows, session_id, lock=True), metadata.target_id)
    require_joints(rows, session_id, [("joint_angles_deg", metadata.joint_angles_deg)])
    siblings: list[str] = []
    known = rows.first(_KNOWN, session_id=session_id, pose_id=pose_id, sha256=sha256)
    assert known is not None
    elsewhere, pose_is_known = known
    if elsewhere:
        first = find_same(rows, session_id, pose_id, sha256, intended)
        if first is not None:
            return first
        found = rows.all(_SIBLINGS, session_id=session_id, pose_id=pose_id, sha256=sha256)
        siblings = sorted(measurement_id for (measurement_id,) in found)
    count_upload(rows, image.size)
    if not pose_is_known:
        ensure_pose(rows, session_id, pose_id)
    row = _row(image, metadata, intended)
    rows.all(_ADD, **row)
    note_objects([row["id"]])
    return NewMeasurement(row, siblings, bool(elsewhere))


def _row(image: ReceivedImage, metadata: Metadata, intended: TargetChoice) -> dict[str, Any]:
    return {
        "id": new_id("mea"),
        "session_id": image.session_id,
        "pose_id": image.pose_id,
        "target_id": intended.target_id,
        "seeks_target": not intended.named,
        "stated_target_id": intended.target_id if intended.named else None,
        "cycle": metadata.cycle,
        "burst": stored_burst(metadata.burst),
        "focus_group": metadata.focus_group,
        "joint_angles_deg": metadata.joint_angles_deg,
        "captured_at": metadata.captured_at,
        "received_at": datetime.now(UTC),
        "sha256": image.sha256,
        "filename": image.filename,
        "pose_label": metadata.pose_label,
        "bytes": image.size,
        "image_format": image.header.format,
        "image_width_px": image.header.width_px,
        "image_height_px": image.header.height_px,
        "status": "queued",
        "attempts": 0,
        "made_by": maker(),
    }


def _require_visible(session_id: str) -> None:
    if not is_id(session_id) or not may_see_session(session_id):
        raise NotFound.of(NOUNS[Session])
