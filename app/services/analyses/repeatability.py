"""Repeatability of every pose of a session by ISO 9283, each figure with its interval and the instrument's part."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from app.services.analyses.accuracy import Accuracy, assess_accuracy
from app.services.analyses.documents import advisories, camera_fields
from app.services.analyses.estimation import EstimatedImage, Exclusion, SessionEstimate, estimate_session
from app.services.analyses.outcome import CannotAnalyse
from app.services.analyses.snapshot import Snapshot
from core import Advisory
from core.metrology import Figures, PoseCycles, PoseRepeatability, Verdict, assess_repeatability, drift

NAMES = ("position_mm", "x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg")
DRIFT_BLOCK = 10
NAMED = 5

Value = TypeVar("Value")


@dataclass(frozen=True, slots=True)
class PoseRow:
    """One pose: the images that count for it, in order, and those that do not."""

    pose_id: str
    images: list[EstimatedImage]
    excluded: list[Exclusion]
    figures: PoseRepeatability | None


def repeatability_document(
    snapshot: Snapshot, points: Mapping[str, bytes], settings: Mapping[str, str]
) -> dict[str, Any]:
    """Return what `GET .../repeatability` answers, but for the fields every analysis has."""
    if settings["source"] == "measured_poses":
        raise CannotAnalyse(
            "measured_poses_missing",
            "The session holds no poses measured by another instrument.",
            "Leave source away to analyse the session's images.",
        )
    session = estimate_session(snapshot, points, settings["estimator"])
    rows = pose_rows(snapshot, session)
    accuracy = assess_accuracy(snapshot, {row.pose_id: row.images for row in rows if row.images})
    return {
        "estimator": settings["estimator"],
        "source": settings["source"],
        "confidence_level": float(settings["confidence_level"]),
        "poses": [_row_document(row, accuracy) for row in rows],
        "intrinsics": [camera_fields(group) for group in session.groups],
        "drift": _drift_document(rows),
        "warnings": advisories((*session.warnings, *_remarks(rows), *accuracy.warnings)),
    }


def pose_rows(snapshot: Snapshot, session: SessionEstimate) -> list[PoseRow]:
    """Sort the images by pose, one target a pose, and compute every pose's figures."""
    found = {e.image.measurement_id: e for e in session.images}
    images: dict[str, list[EstimatedImage]] = {}
    excluded: dict[str, list[Exclusion]] = {}
    for image in snapshot.images:
        images.setdefault(image.pose_id, [])
        excluded.setdefault(image.pose_id, [])
        if image.measurement_id in found:
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
    figures = {
        pose_id: _in_doubt(one)
        if session.contradicted.intersection(e.image.focus_group for e in images[pose_id])
        else one
        for pose_id, one in assessed.items()
    }
    return [
        _without_outliers(PoseRow(pose_id, images[pose_id], excluded[pose_id], figures.get(pose_id)))
        for pose_id in images
    ]


def _in_doubt(figures: PoseRepeatability) -> PoseRepeatability:
    """Return the figures of a pose whose images contradict their camera: none of them is said to be the robot's."""

    def judged(verdict: Verdict | None) -> Verdict | None:
        return Verdict.INSTRUMENT_LIMITED if verdict == Verdict.ROBOT else verdict

    return replace(
        figures,
        verdict=judged(figures.verdict) or figures.verdict,
        verdicts=Figures(*(judged(verdict) for _, verdict in figures.verdicts.items())),
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


def _without_outliers(row: PoseRow) -> PoseRow:
    figures = row.figures
    if figures is None or not figures.excluded:
        return row
    without = figures.with_excluded
    would = "" if without is None else f" Counted, RP_l would be {without.position_mm:.4g} mm."
    outliers = [
        Exclusion(row.images[e.index].image.measurement_id, e.code, e.detail + would)
        for e in figures.excluded
    ]
    return PoseRow(row.pose_id, [row.images[i] for i in figures.used], [*row.excluded, *outliers], figures)


def _row_document(row: PoseRow, accuracy: Accuracy) -> dict[str, Any]:
    figures = row.figures
    nothing: Figures[Any] = Figures(None, None, None, None, None, None, None)
    return {
        "pose_id": row.pose_id,
        "n": len(row.images),
        "mean": _mean(figures),
        "repeatability": _fields(figures.repeatability if figures else nothing, _number),
        "interval": _fields(figures.interval if figures else nothing, _pair),
        "noise_floor": _fields(figures.noise_floor if figures else nothing, _number),
        "corrected": _fields(figures.corrected if figures else nothing, _number),
        "accuracy": _fields(accuracy.poses[row.pose_id], _number) if row.pose_id in accuracy.poses else None,
        "verdict": figures.verdict if figures else "too_few_cycles",
        "used": [e.image.measurement_id for e in row.images],
        "excluded": [
            {"measurement_id": e.measurement_id, "code": e.code, "detail": e.detail} for e in row.excluded
        ],
        "with_excluded": _fields(figures.with_excluded, _number)
        if figures and figures.with_excluded
        else None,
    }


def _mean(figures: PoseRepeatability | None) -> dict[str, Any]:
    if figures is None or figures.mean_roll_pitch_yaw is None:
        return dict.fromkeys(("position_mm", "roll_deg", "pitch_deg", "yaw_deg"))
    roll, pitch, yaw = np.degrees(figures.mean_roll_pitch_yaw).tolist()
    return {
        "position_mm": figures.mean_position_mm.tolist(),
        "roll_deg": roll,
        "pitch_deg": pitch,
        "yaw_deg": yaw,
    }


def _fields(figures: Figures[Value | None], to_json: Callable[[Value, float], Any]) -> dict[str, Any]:
    """Return figures under the API's names; angles in degrees."""
    values = [value for _, value in figures.items()]
    factors = [math.degrees(1.0) if name.endswith("_deg") else 1.0 for name in NAMES]
    return {
        name: None if value is None else to_json(value, factor)
        for name, value, factor in zip(NAMES, values, factors, strict=True)
    }


def _number(value: float, factor: float) -> float:
    return factor * value


def _pair(value: tuple[float, float], factor: float) -> list[float]:
    return [factor * value[0], factor * value[1]]


def _drift_document(rows: Sequence[PoseRow]) -> dict[str, Any] | None:
    """Return how each pose moved from its first cycles to its last, where there are two blocks of cycles."""
    documents = []
    for row in rows:
        images = [e for e in row.images if e.image.cycle is not None]
        if len(images) < 2 * DRIFT_BLOCK:
            continue
        found = drift(
            np.array([e.position_mm for e in images]),
            np.array([e.rotation for e in images]),
            block=DRIFT_BLOCK,
        )
        cycles = [e.image.cycle for e in images]
        documents.append(
            {
                "pose_id": row.pose_id,
                "shift_mm": found.shift_mm.tolist(),
                "shift_deg": np.degrees(found.shift_rad).tolist() if found.shift_rad is not None else None,
                "repeatability_change_mm": found.repeatability_drift_mm,
                "blocks": [
                    {
                        "first_cycle": cycles[block.first_cycle - 1],
                        "last_cycle": cycles[block.last_cycle - 1],
                        "mean_position_mm": block.mean_position_mm.tolist(),
                        "repeatability_mm": block.repeatability_mm,
                    }
                    for block in found.blocks
                ],
            }
        )
    return {"poses": documents} if documents else None


def _remarks(rows: Sequence[PoseRow]) -> list[Advisory]:
    """Return the poses' own remarks, those of one kind together."""
    kinds: dict[str, list[tuple[str, Advisory]]] = {}
    for row in rows:
        for remark in row.figures.warnings if row.figures else ():
            kinds.setdefault(remark.code, []).append((row.pose_id, remark))
    remarks = []
    for code, found in kinds.items():
        names = [pose_id for pose_id, _ in found]
        listed = ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")
        first = found[0][1]
        noun = "Pose" if len(names) == 1 else "Poses"
        also = "" if len(names) == 1 else " (of the first)"
        remarks.append(Advisory(code, f"{noun} {listed}: {first.detail}{also}", first.advice))
    if len([row for row in rows if len(row.images) > 1]) == 0:
        remarks.append(
            Advisory(
                "too_few_cycles",
                "No pose has two images that count, so that nothing is known of repeatability.",
                "Visit every pose again: the standard asks for 30 cycles.",
            )
        )
    return remarks
