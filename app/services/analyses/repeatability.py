"""Repeatability of every pose of a session by ISO 9283, each figure with its interval and the instrument's part."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from app.services.analyses.accuracy import assess_accuracy
from app.services.analyses.documents import advisories, camera_fields
from app.services.analyses.estimation import EstimatedImage, Exclusion, SessionEstimate, estimate_session
from app.services.analyses.measured import measured_repeatability
from app.services.analyses.performance import assess_performance, of_image
from app.services.analyses.pose_rows import Row, drift_document, row_document, row_remarks, without_outliers
from app.services.analyses.snapshot import Snapshot
from core.metrology import Figures, PoseCycles, PoseRepeatability, Verdict, assess_repeatability

PoseRow = Row[EstimatedImage]
"""One pose: the images that count for it, in order, and those that do not."""


def repeatability_document(
    snapshot: Snapshot, points: Mapping[str, bytes], settings: Mapping[str, str]
) -> dict[str, Any]:
    """Return what `GET .../repeatability` answers, but for the fields every analysis has."""
    if settings["source"] == "measured_poses":
        return measured_repeatability(snapshot, settings)
    session = estimate_session(snapshot, points, settings["estimator"])
    rows = pose_rows(snapshot, session)
    accuracy = assess_accuracy(snapshot, {row.pose_id: row.images for row in rows if row.images})
    performance = assess_performance(rows, snapshot.commanded, of_image)
    return {
        "estimator": settings["estimator"],
        "source": settings["source"],
        "confidence_level": float(settings["confidence_level"]),
        "poses": [row_document(row, accuracy) for row in rows],
        "intrinsics": [camera_fields(group) for group in session.groups],
        "drift": drift_document(rows),
        "distances": performance.distances,
        "approach_variation": performance.approach_variation,
        "warnings": advisories(
            (*session.warnings, *row_remarks(rows), *accuracy.warnings, *performance.warnings)
        ),
    }


def pose_rows(snapshot: Snapshot, session: SessionEstimate) -> list[PoseRow]:
    """Sort the images by pose, one target a pose, and compute every pose's figures."""
    found = {e.image.measurement_id: e for e in session.images}
    images: dict[str, list[EstimatedImage]] = {}
    excluded: dict[str, list[Exclusion]] = {}
    for image in snapshot.images:
        images.setdefault(image.pose_id, [])
        excluded.setdefault(image.pose_id, [])
        if image.measurement_id in session.unclear:
            excluded[image.pose_id].append(session.unclear[image.measurement_id])
        elif image.measurement_id in found:
            images[image.pose_id].append(found[image.measurement_id])
        else:
            excluded[image.pose_id].append(session.excluded[image.measurement_id])
    for pose_id in images:
        images[pose_id], others = _of_one_target(images[pose_id])
        excluded[pose_id] += others
    several = [pose_id for pose_id in images if images[pose_id]]
    assessed = dict(
        zip(
            several,
            assess_repeatability(
                [
                    PoseCycles(
                        np.array([e.position_mm for e in images[pose_id]]),
                        np.array([e.rotation for e in images[pose_id]]),
                        np.array([e.scatter for e in images[pose_id]]),
                    )
                    for pose_id in several
                ]
            ),
            strict=True,
        )
    )
    doubtful = session.unsteady | session.differing
    figures = {pose_id: _in_doubt(one) if pose_id in doubtful else one for pose_id, one in assessed.items()}
    return [
        without_outliers(PoseRow(pose_id, images[pose_id], excluded[pose_id], figures.get(pose_id)))
        for pose_id in images
    ]


def _in_doubt(figures: PoseRepeatability) -> PoseRepeatability:
    """Return the figures of a pose that scatters by its camera's change, or by what its images do not all show.

    None of them is said to be the robot's, and from none is anything taken off: how much is the instrument's is not
    known.
    """

    def judged(verdict: Verdict | None) -> Verdict | None:
        return Verdict.INSTRUMENT_LIMITED if verdict == Verdict.ROBOT else verdict

    return replace(
        figures,
        verdict=judged(figures.verdict) or figures.verdict,
        verdicts=Figures(*(judged(verdict) for _, verdict in figures.verdicts.items())),
        corrected=figures.repeatability,
        corrected_interval=Figures(None, None, None, None, None, None, None),
    )


def _of_one_target(images: list[EstimatedImage]) -> tuple[list[EstimatedImage], list[Exclusion]]:
    """Return the images of the target that most show: places in the frames of different targets do not compare."""
    counts = Counter(e.image.target for e in images)
    if len(counts) < 2:
        return images, []
    target = min(counts, key=lambda target: (-counts[target], target))
    detail = (
        "Most images of this pose show another of the session's targets, whose frame this pose is given in."
    )
    others = [
        Exclusion(e.image.measurement_id, "other_target", detail) for e in images if e.image.target != target
    ]
    return [e for e in images if e.image.target == target], others
