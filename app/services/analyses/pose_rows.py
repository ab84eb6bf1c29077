"""Poses' rows of the repeatability table, whatever measured them: figures, mean, drift and remarks as documents."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from jaxtyping import Float

from app.services.analyses.commanded_accuracy import Accuracy
from app.services.analyses.estimation import Exclusion
from core import Advisory
from core.metrology import Figures, PoseRepeatability, drift

NAMES = ("position_mm", "x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg")
DRIFT_BLOCK = 10
NAMED = 5

Value = TypeVar("Value")


class Visit(Protocol):
    """One measured visit to a pose: an image whose camera was estimated, or another instrument's reading."""

    @property
    def measurement_id(self) -> str: ...
    @property
    def cycle(self) -> int | None: ...
    @property
    def position_mm(self) -> Float[np.ndarray, "3"]: ...
    @property
    def rotation(self) -> Float[np.ndarray, "3 3"] | None: ...
    @property
    def covariance(self) -> Float[np.ndarray, "6 6"] | None: ...


AnyVisit = TypeVar("AnyVisit", bound=Visit)


@dataclass(
    frozen=True
)  # not slots: a frozen generic dataclass of Python 3.11 cannot be made by its alias then
class Row(Generic[AnyVisit]):
    """One pose: the images (or other readings) that count for it, in order, and those that do not."""

    pose_id: str
    images: list[AnyVisit]
    excluded: list[Exclusion]
    figures: PoseRepeatability | None


def without_outliers(row: Row[AnyVisit]) -> Row[AnyVisit]:
    """Return the row with the outliers its figures leave out among the excluded, and named as such."""
    figures = row.figures
    if figures is None or not figures.excluded:
        return row
    without = figures.with_excluded
    would = "" if without is None else f" Counted, RP_l would be {without.position_mm:.4g} mm."
    outliers = [
        Exclusion(row.images[e.index].measurement_id, e.code, e.detail + would) for e in figures.excluded
    ]
    return Row(row.pose_id, [row.images[i] for i in figures.used], [*row.excluded, *outliers], figures)


def row_document(row: Row[AnyVisit], accuracy: Accuracy) -> dict[str, Any]:
    """Return one pose as the API shows it."""
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
        "used": [e.measurement_id for e in row.images],
        "excluded": [
            {"measurement_id": e.measurement_id, "code": e.code, "detail": e.detail} for e in row.excluded
        ],
        "with_excluded": _fields(figures.with_excluded, _number)
        if figures and figures.with_excluded
        else None,
    }


def _mean(figures: PoseRepeatability | None) -> dict[str, Any]:
    angles = figures.mean_roll_pitch_yaw if figures else None
    return {
        "position_mm": figures.mean_position_mm.tolist() if figures else None,
        **dict(
            zip(
                ("roll_deg", "pitch_deg", "yaw_deg"),
                np.degrees(angles).tolist() if angles is not None else [None] * 3,
                strict=True,
            )
        ),
    }


def figure_fields(figures: Figures[float | None]) -> dict[str, Any]:
    """Return one value a figure under the API's names; angles in degrees."""
    return _fields(figures, _number)


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


def drift_document(rows: Sequence[Row[AnyVisit]]) -> dict[str, Any] | None:
    """Return how each pose moved from its first cycles to its last, where there are two blocks of cycles."""
    documents = []
    for row in rows:
        images = [e for e in row.images if e.cycle is not None]
        if len(images) < 2 * DRIFT_BLOCK:
            continue
        rotations = [e.rotation for e in images if e.rotation is not None]
        found = drift(
            np.array([e.position_mm for e in images]),
            np.array(rotations) if len(rotations) == len(images) else None,
            block=DRIFT_BLOCK,
        )
        cycles = [e.cycle for e in images]
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


def row_remarks(rows: Sequence[Row[AnyVisit]]) -> list[Advisory]:
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
