"""Rows that become jobs again, many in one statement. Their results stay until others replace them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy import orm

from app.records.tables import Measurement, Result, Table

TOGETHER = 1000
"""Rows of one statement."""
_OF_RESULT = ("finished_at", "duration_ms", "failure_code", "failure_detail", "failure_advice")


class ImageRow(NamedTuple):
    """A row of an image, as far as searching for targets goes."""

    id: str
    target_id: str | None
    seeks_target: bool
    stated_target_id: str | None = None


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

    Images whose stated target came back are searched for that one alone, and what a search found meanwhile goes.
    Of the others these are the images with a measurement whose target went, those in which no target was found and,
    where there are new targets, all that were sent without one; but not those that have a measurement of every target.
    """
    images: dict[tuple[str, str], list[ImageRow]] = {}
    for row in records.execute(
        sa.select(
            Measurement.pose_id,
            Measurement.sha256,
            Measurement.id,
            Measurement.target_id,
            Measurement.seeks_target,
            Measurement.stated_target_id,
        )
        .where(Measurement.session_id == session_id)
        .order_by(Measurement.id)
    ):
        of_image = images.setdefault((row.pose_id, row.sha256), [])
        of_image.append(ImageRow(row.id, row.target_id, row.seeks_target, row.stated_target_id))
    wanted = frozenset(target_ids)
    came_back: list[str] = []
    left_over: list[str] = []
    ids: list[str] = []
    for image in images.values():
        back = rows_of_stated(image, wanted)
        came_back += [row.id for row in back]
        returned = {row.id: row._replace(target_id=row.stated_target_id, seeks_target=False) for row in back}
        now = [returned.get(row.id, row) for row in image]
        gone = {
            row.id for row in now if row.stated_target_id in wanted and row.target_id != row.stated_target_id
        }
        left_over += gone
        found = row_to_search([row for row in now if row.id not in gone], wanted, with_new=with_new)
        ids += [found] if found is not None else []
    for some in _in_parts(left_over):
        _delete(records, Measurement, Measurement.id.in_(some))
    for some in _in_parts(came_back):
        other = Measurement.target_id.is_distinct_from(Measurement.stated_target_id)
        of_other = sa.select(Measurement.id).where(Measurement.id.in_(some), other)
        _delete(records, Result, Result.measurement_id.in_(of_other))
        queue_rows(records, some, seeks_target=False, target_id=Measurement.stated_target_id)
    for some in _in_parts(ids):
        queue_rows(records, some, seeks_target=True)
    return len(came_back) + len(ids)


def rows_of_stated(image: Sequence[ImageRow], wanted: frozenset[str]) -> list[ImageRow]:
    """Return which of an image's rows are to be of their stated target again, since it is one of `wanted`."""
    held = {row.target_id for row in image}
    back: list[ImageRow] = []
    for row in image:
        stated = row.stated_target_id
        if stated not in wanted or (stated == row.target_id and not row.seeks_target):
            continue
        if stated == row.target_id or stated not in held:
            back.append(row)
            held.add(stated)
    return back


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


def _delete(records: orm.Session, table: type[Table], which: sa.ColumnElement[bool]) -> None:
    records.execute(sa.delete(table).where(which), execution_options={"synchronize_session": False})


def _in_parts(ids: Sequence[str]) -> Iterator[Sequence[str]]:
    for start in range(0, len(ids), TOGETHER):
        yield ids[start : start + TOGETHER]
