"""The originals of a report, read, hashed and measured anew, and compared with the stored grid points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import sqlalchemy as sa

from app.analyses.reporting.inputs import target_row
from app.analyses.reporting.orders import VerificationOrder
from app.blobs import open_store
from app.errors import OriginalCorrupt, OriginalMissing
from app.jobs.process_image import process_image
from app.jobs.queue import Job, TargetQuery, read_jobs
from app.records.codec import point_places
from app.records.database import Database
from app.records.outcome import Outcome
from app.records.statements import rows_of
from app.records.tables import Measurement, Result, target_fields

Json = dict[str, Any]
_LOST = {OriginalCorrupt.code: "original changed", OriginalMissing.code: "original missing"}
MAX_POINT_DIFFERENCE_PX = 1e-6
"""Grid points that another build finds this near are the same ones."""
_AT_ONCE = 100


def measure_anew(
    database: Database, inputs: Mapping[str, Any], order: VerificationOrder
) -> tuple[Json, list[tuple[str, str]]]:
    """Return how the originals, measured anew, compare with the report's results, and which originals are changed.

    Each is searched for the targets that the report states. An image that the report does not count, such as an
    excluded one, is compared with its stored result. A measurement that was refused without grid points counts as
    identical where its original is there unchanged.
    """
    store = open_store(order.blob_url, Path(order.folder), database.exclude_others)
    measured = identical = 0
    largest: float | None = None
    differing: list[Json] = []
    lost: list[tuple[str, str]] = []
    seen: dict[tuple[str, str], Outcome] = {}
    for image, job, stored in _jobs(database, inputs):
        key = (job.sha256, repr([target.target_id for target in job.targets]))
        if key not in seen:
            seen.clear()  # rows of one image follow one another
            path = store.address(job.sha256)
            seen[key], _ = process_image(job, path, order.max_image_pixels)
        outcome = seen[key]
        if outcome.failure is not None and outcome.failure.code in _LOST:
            lost.append((image["measurement_id"], _LOST[outcome.failure.code]))
            continue
        measured += 1
        found, failure = _own(outcome, job, image["target_id"])
        content = image["content_sha256"] or (stored["content_sha256"] if stored is not None else None)
        if content is None or (found is not None and found["content_sha256"] == content):
            identical += 1
            continue
        points = stored["points"] if stored is not None and stored["content_sha256"] == content else None
        difference = _difference_px(points, found["points"] if found is not None else None)
        if difference is not None:
            largest = max(largest or 0.0, difference)
        if difference is None or difference > MAX_POINT_DIFFERENCE_PX:
            differing.append(
                {
                    "measurement_id": image["measurement_id"],
                    "detail": failure or "other grid points are found",
                    "largest_point_difference_px": difference,
                }
            )
    found_all = {
        "measured": measured,
        "identical": identical,
        "largest_point_difference_px": largest,
        "differing": differing,
    }
    return found_all, lost


def _jobs(
    database: Database, inputs: Mapping[str, Any]
) -> Iterator[tuple[Json, Job, Mapping[str, Any] | None]]:
    """Yield each image that is still stored, the job that measures it as its result was, and that result's columns.

    Images of one file follow one another. A file that was searched for all targets is searched for all of them again.
    """
    ordered = sorted(inputs["images"], key=lambda image: (image["sha256"], image["measurement_id"]))
    for start in range(0, len(ordered), _AT_ONCE):
        some = ordered[start : start + _AT_ONCE]
        ids = [image["measurement_id"] for image in some]
        with database.read() as records:
            columns = sa.select(Measurement.id, Measurement.seeks_target).where(Measurement.id.in_(ids))
            present = {row.id: row.seeks_target for row in records.execute(columns)}
            jobs, _unreadable = read_jobs(rows_of(records), [i for i in ids if i in present], "verification")
            stored = {
                row.measurement_id: dict(row._mapping)
                for row in records.execute(
                    sa.select(Result.measurement_id, Result.content_sha256, Result.points).where(
                        Result.measurement_id.in_(ids)
                    )
                )
            }
        own = {image["measurement_id"]: image["target_id"] for image in some}
        of = {
            job.measurement_id: _as_reported(
                replace(job, target_id=own[job.measurement_id]), inputs, present[job.measurement_id]
            )
            for job in jobs
        }
        searched = {job.sha256: job for job in of.values() if not job.has_explicit_target}
        for image in some:
            job = of.get(image["measurement_id"])
            if job is not None:
                yield image, searched.get(job.sha256, job), stored.get(image["measurement_id"])


def _as_reported(job: Job, inputs: Mapping[str, Any], seeks_target: bool) -> Job:
    """Return the job with camera and targets as the report states them, whatever the session states since."""
    stated = {one["id"]: target_row(one) for one in inputs["targets"]}
    sought = list(stated) if seeks_target else [one.target_id for one in job.targets]
    if not seeks_target and job.target_id in stated:
        sought = [job.target_id]
    now = {one.target_id: one for one in job.targets}
    return replace(
        job,
        targets=tuple(
            TargetQuery(name, target_fields(stated[name])) if name in stated else now[name] for name in sought
        ),
        lens=inputs["session"]["lens"],
        intrinsics=inputs["session"]["intrinsics"],
    )


def _own(outcome: Outcome, job: Job, target_id: str | None) -> tuple[Json | None, str | None]:
    """Return the columns that an outcome gives of a target, and why it failed."""
    result, failure = outcome.result, outcome.failure
    if not job.has_explicit_target:
        shown = next((one for one in outcome.shown if one.target_id == target_id), None)
        if shown is not None:
            result, failure = shown.result, shown.failure
    return result, failure.detail if failure is not None else None


def _difference_px(before: bytes | None, after: bytes | None) -> float | None:
    """Return the largest distance of two stored sets of grid points, px; None where they are not of the same labels."""
    if before is None or after is None or len(before) != len(after):
        return None
    (labels_before, places_before), (labels_after, places_after) = point_places(before), point_places(after)
    if not np.array_equal(labels_before, labels_after):
        return None
    return float(np.linalg.norm(places_before - places_after, axis=1).max(initial=0.0))
