"""Pages of a session's images by number, newest or oldest first, by state, pose and code; their counts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import Literal

import sqlalchemy as sa
from sqlalchemy import orm
from sqlalchemy.sql.elements import ColumnElement

from app.jobs.queue import ALREADY_MEASURED
from app.records.ids import moment_of
from app.records.tables import Measurement, Result, Session
from app.services.queries import get_or_raise

ImageState = Literal["waiting", "measured", "weak", "failed", "excluded", "duplicate"]
SENT_TOGETHER = timedelta(seconds=2)
"""Images of a pose that come in a shorter time than a robot takes for another visit."""
MAX_GRADED = 5_000
"""Images of a session of which the weak ones are counted: it reads a document of each."""


_WEAK = (
    Measurement.status == "succeeded",
    sa.exists().where(
        Result.measurement_id == Measurement.id,
        # As text: a damaged document is no error here, and its image says that it cannot be read.
        sa.cast(Result.calibration, sa.Text()).contains('"grade": "weak"'),
    ),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class GalleryFilter:
    """Which images are shown; None: all."""

    state: ImageState | None = None
    pose_id: str | None = None
    code: str | None = None
    oldest_first: bool = False


@dataclass(frozen=True, slots=True)
class GalleryPage:
    """One page of `pages`, its number from 1, and how many images the filter leaves."""

    items: Sequence[Measurement]
    page: int
    pages: int
    total: int


@dataclass(frozen=True, slots=True)
class GalleryCounts:
    """How many measurements of a session have each pose and each failure code, and how many are excluded.

    `cycles` are those of each pose: the images of one stop are one; an image without a cycle counts by itself.
    `weak` are those measured ones that determine their focal length weakly; None in a session beyond MAX_GRADED.
    """

    poses: list[tuple[str, int]]
    cycles: list[tuple[str, int]]
    codes: list[tuple[str, int]]
    excluded: int
    weak: int | None


def list_gallery(
    records: orm.Session, session_id: str, chosen: GalleryFilter, *, page: int, size: int
) -> GalleryPage:
    """Return a page of a session's images with their results; a number beyond the last page gives the last.

    Raises NotFound.
    """
    get_or_raise(records, Session, session_id)
    which = [Measurement.session_id == session_id, *_conditions(chosen)]
    total = records.scalar(sa.select(sa.func.count()).select_from(Measurement).where(*which)) or 0
    pages = max(1, -(-total // size))
    page = min(max(page, 1), pages)
    order = Measurement.id.asc() if chosen.oldest_first else Measurement.id.desc()
    ids = sa.select(Measurement.id).where(*which).order_by(order).limit(size).offset((page - 1) * size)
    found = records.scalars(
        sa.select(Measurement)
        .where(Measurement.id.in_(records.scalars(ids).all()))
        .order_by(order)
        .options(orm.joinedload(Measurement.result).load_only(Result.calibration, Result.labelling))
    ).all()
    return GalleryPage(in_order_of_cycles(found, chosen.oldest_first), page, pages, total)


def in_order_of_cycles(found: Sequence[Measurement], oldest_first: bool) -> list[Measurement]:
    """Return images as they were received; those of one pose that were sent together, several at a time, by cycle.

    Which of them arrives first is chance.
    """
    ordered = list(found)
    places: dict[str, list[int]] = {}
    for place, one in enumerate(found):
        places.setdefault(one.pose_id, []).append(place)
    for of_pose in places.values():
        together: list[int] = []
        for place in of_pose:
            if together and not _sent_together(found[together[-1]], found[place]):
                together = []
            together.append(place)
            by_cycle = sorted((found[k] for k in together), key=_cycle_and_burst, reverse=not oldest_first)
            for k, one in zip(together, by_cycle, strict=True):
                ordered[k] = one
    return ordered


def _sent_together(one: Measurement, other: Measurement) -> bool:
    known = one.cycle is not None and other.cycle is not None
    return known and abs(moment_of(one.id) - moment_of(other.id)) < SENT_TOGETHER


def _cycle_and_burst(one: Measurement) -> tuple[int, int]:
    return one.cycle or 0, one.burst or 0


def count_gallery(records: orm.Session, session_id: str) -> GalleryCounts:
    """Return what a session's images can be filtered by."""
    of_session = Measurement.session_id == session_id
    number = sa.func.count()
    stops = sa.func.count(Measurement.cycle.distinct()) + number - sa.func.count(Measurement.cycle)
    poses = records.execute(
        sa.select(Measurement.pose_id, number, stops).where(of_session).group_by(Measurement.pose_id)
    ).all()
    codes = records.execute(
        sa.select(Measurement.failure_code, number)
        .where(of_session, Measurement.status == "failed", Measurement.failure_code.is_not(None))
        .group_by(Measurement.failure_code)
        .order_by(number.desc(), Measurement.failure_code)
    )
    excluded = records.scalar(
        sa.select(number).select_from(Measurement).where(of_session, Measurement.excluded.is_not(None))
    )
    counted = [(pose_id, count) for pose_id, count, _ in poses]
    cycles = [(pose_id, count) for pose_id, _, count in poses]
    weak = None
    if sum(count for _, count in counted) <= MAX_GRADED:
        weak = records.scalar(sa.select(number).select_from(Measurement).where(of_session, *_WEAK)) or 0
    return GalleryCounts(counted, cycles, [(str(code), count) for code, count in codes], excluded or 0, weak)


def neighbours(records: orm.Session, measurement: Measurement) -> tuple[str | None, str | None]:
    """Return the ids of the images that were received just before and just after this one, in its session."""
    of_session = Measurement.session_id == measurement.session_id
    before = sa.select(sa.func.max(Measurement.id)).where(of_session, Measurement.id < measurement.id)
    after = sa.select(sa.func.min(Measurement.id)).where(of_session, Measurement.id > measurement.id)
    return records.scalar(before), records.scalar(after)


def _conditions(chosen: GalleryFilter) -> list[ColumnElement[bool]]:
    conditions: list[ColumnElement[bool]] = []
    is_duplicate = sa.func.coalesce(Measurement.failure_code, "") == ALREADY_MEASURED.code
    if chosen.state == "waiting":
        conditions.append(Measurement.status.in_(("queued", "running")))
    elif chosen.state == "measured":
        conditions.append(Measurement.status == "succeeded")
    elif chosen.state == "weak":
        conditions += _WEAK
    elif chosen.state == "failed":
        conditions += [Measurement.status == "failed", ~is_duplicate]
    elif chosen.state == "duplicate":
        conditions += [Measurement.status == "failed", is_duplicate]
    elif chosen.state == "excluded":
        conditions.append(Measurement.excluded.is_not(None))
    if chosen.pose_id is not None:
        conditions.append(Measurement.pose_id == chosen.pose_id)
    if chosen.code is not None:
        conditions += [Measurement.status == "failed", Measurement.failure_code == chosen.code]
    return conditions
