"""Rows that become jobs again, many in one statement. Their results stay until others replace them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy import orm

from app.records.tables import Measurement, Result

TOGETHER = 1000
"""Rows of one statement."""
_OF_RESULT = ("finished_at", "duration_ms", "failure_code", "failure_detail", "failure_advice")


class ImageRow(NamedTuple):
    """A row of an image, as far as searching for targets goes."""

    id: str
    target_id: str | None
    seeks_target: bool


def queue_rows(records: orm.Session, measurement_ids: Sequence[str], **changes: Any) -> None:
    """Make rows jobs again, at most TOGETHER, with `changes` of further columns.

    A row that is computed just now is handed out anew: what comes of its present attempt is dropped.
    """
    has_result = sa.exists().where(Result.measurement_id == Measurement.id)
    columns = Measurement.__table__.c
    kept = {name: sa.case((has_result, columns[name]), else_=sa.null()) for name in _OF_RESULT}
    records.execute(
        sa.update(Measurement)
        .where(Measurement.id.in_(measurement_ids))
        .values(status="queued", attempts=0, claim=None, retry_failure=sa.null(), **kept, **changes),
        execution_options={"synchronize_session": False},
    )


def search_again(
    records: orm.Session, session_id: str, target_ids: Collection[str], *, with_new: bool
) -> int:
    """Search images again after the session's targets became `target_ids`; return how many are searched.

    These are the images with a measurement whose target went, those in which no target was found and, where there are
    new targets, all that were sent without one; but not those that have a measurement of every target.
    """
    images: dict[tuple[str, str], list[ImageRow]] = {}
    for row in records.execute(
        sa.select(
            Measurement.pose_id,
            Measurement.sha256,
            Measurement.id,
            Measurement.target_id,
            Measurement.seeks_target,
        )
        .where(Measurement.session_id == session_id)
        .order_by(Measurement.id)
    ):
        of_image = images.setdefault((row.pose_id, row.sha256), [])
        of_image.append(ImageRow(row.id, row.target_id, row.seeks_target))
    wanted = frozenset(target_ids)
    found = [row_to_search(image, wanted, with_new=with_new) for image in images.values()]
    ids = [measurement_id for measurement_id in found if measurement_id is not None]
    for some in _in_parts(ids):
        queue_rows(records, some, seeks_target=True)
    return len(ids)


def row_to_search(image: Sequence[ImageRow], wanted: frozenset[str], *, with_new: bool) -> str | None:
    """Return which of an image's rows is to search for the targets `wanted`, None where none has to.

    One row of an image searches; where none did, since each named its target, the first does whose target went.
    """
    if wanted <= {row.target_id for row in image}:
        return None
    gone = [row.id for row in image if row.target_id is not None and row.target_id not in wanted]
    searching = next((row for row in image if row.seeks_target), None)
    if searching is None:
        return gone[0] if gone else None
    return searching.id if gone or with_new or searching.target_id is None else None


def _in_parts(ids: Sequence[str]) -> Iterator[Sequence[str]]:
    for start in range(0, len(ids), TOGETHER):
        yield ids[start : start + TOGETHER]
