"""Reading measurements, their grid points and their originals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import FileIO
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import RowUnreadable
from app.records.codec import are_points, points_documents
from app.records.pagination import page
from app.records.tables import Measurement, Result, Session, Target
from app.services.installation.context import ServiceContext
from app.services.queries import get_or_raise


@dataclass(frozen=True, slots=True)
class MeasurementDetail:
    """A measurement with its result, and the ids of the others of the same image at the same pose, oldest first."""

    measurement: Measurement
    siblings: list[str]


def has_image_of_size(records: orm.Session, session_id: str, least: int, most: int) -> bool:
    """Return whether a session has an image of so many bytes."""
    query = sa.select(Measurement.id).where(
        Measurement.session_id == session_id, Measurement.bytes.between(least, most)
    )
    return records.scalar(query.limit(1)) is not None


def get_measurement(records: orm.Session, measurement_id: str) -> MeasurementDetail:
    """Return one measurement."""
    get_or_raise(records, Measurement, measurement_id)
    measurement = records.scalars(
        sa.select(Measurement)
        .where(Measurement.id == measurement_id)
        .options(orm.joinedload(Measurement.result))
        .execution_options(populate_existing=True)
    ).one()
    return with_siblings(records, [measurement])[0]


def get_points(records: orm.Session, measurement_id: str) -> list[dict[str, Any]] | None:
    """Return every grid point found, or None where none is known (yet).

    Raises RowUnreadable.
    """
    points = records.scalar(sa.select(Result.points).where(Result.measurement_id == measurement_id))
    if points is None:
        return None
    if not are_points(points):
        raise RowUnreadable("measurement", ["points"], "Retry the measurement, which computes it again.")
    return points_documents(points)


def sought_target(records: orm.Session, measurement: Measurement) -> Target | None:
    """Return the target of a measurement, or the session's first where the image shows none of them."""
    target_id = measurement.target_id
    if target_id is None:
        session = records.get_one(Session, measurement.session_id)
        target_id = next((target.target_id for target in session.targets), None)
    return None if target_id is None else records.get(Target, target_id)


def list_measurements(
    records: orm.Session,
    session_id: str,
    *,
    status: str | None,
    pose_id: str | None,
    limit: int,
    cursor: str | None,
) -> tuple[list[MeasurementDetail], str | None]:
    """Return one page of a session's measurements."""
    get_or_raise(records, Session, session_id)
    statement = (
        sa.select(Measurement)
        .where(Measurement.session_id == session_id)
        .options(orm.joinedload(Measurement.result))
    )
    if status is not None:
        statement = statement.where(Measurement.status == status)
    if pose_id is not None:
        statement = statement.where(Measurement.pose_id == pose_id)
    rows, next_cursor = page(records, statement, Measurement.id, limit=limit, cursor=cursor)
    return with_siblings(records, rows), next_cursor


def find_original(installation: ServiceContext, measurement_id: str) -> tuple[Measurement, str]:
    """Return a measurement and where its original lies; its bytes have not been looked at."""
    with installation.database.read() as records:
        measurement = get_or_raise(records, Measurement, measurement_id)
    return measurement, installation.blobs.address(measurement.sha256)


def open_image(installation: ServiceContext, measurement_id: str) -> tuple[Measurement, FileIO]:
    """Return a measurement and its original, opened, all of whose bytes were found to be those uploaded.

    Raises OriginalMissing, OriginalCorrupt.
    """
    with installation.database.read() as records:
        measurement = get_or_raise(records, Measurement, measurement_id)
    return measurement, installation.blobs.open(measurement.sha256, measurement.bytes)


def with_siblings(records: orm.Session, measurements: Sequence[Measurement]) -> list[MeasurementDetail]:
    """Return these measurements of one session with the others of their images; one question for all of them."""
    if not measurements:
        return []
    of_image: dict[tuple[str, str], list[str]] = {}
    # Not in the order of ids, for which SQLite would read the whole session.
    for measurement_id, pose_id, sha256 in records.execute(
        sa.select(Measurement.id, Measurement.pose_id, Measurement.sha256).where(
            Measurement.session_id == measurements[0].session_id,
            Measurement.pose_id.in_({m.pose_id for m in measurements}),
            Measurement.sha256.in_({m.sha256 for m in measurements}),
        )
    ):
        of_image.setdefault((pose_id, sha256), []).append(measurement_id)
    return [
        MeasurementDetail(m, sorted(set(of_image.get((m.pose_id, m.sha256), ())) - {m.id}))
        for m in measurements
    ]
