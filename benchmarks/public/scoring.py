"""What a detector delivered in one image against the truth, and the figures of many images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.public.suite import Item

WRONG_PX = 2.0
"""A point further than this from where its label is does not count as found, but as wrong."""


@dataclass(frozen=True, slots=True)
class Score:
    """One image by one detector.

    `asked` is how many of the points that it could deliver are in view, `wrong` how many it delivered at a wrong
    place, `labels` and `errors_px` (n, 2) those that are right and in view.
    """

    item: Item
    asked: int
    wrong: int
    labels: np.ndarray
    errors_px: np.ndarray
    seconds: float


def score(item: Item, labels: np.ndarray, points_px: np.ndarray, markers: bool, seconds: float) -> Score:
    """Compare with the truth; `markers` says that the detector delivers marker corners in place of grid points.

    A chessboard's labels are taken in whichever of the grid's symmetries agrees best: detectors differ in which corner
    comes first.

    Raises ValueError for labels and points that do not belong together, or a label the target does not have.
    """
    labels, points_px = np.asarray(labels), np.asarray(points_px, np.float64)
    truth, visible = item.truth_px, item.visible
    if labels.ndim != 1 or points_px.shape != (len(labels), 2):
        raise ValueError(
            f"detect returned labels {labels.shape} and points {points_px.shape}, not (n,) and (n, 2)."
        )
    if len(labels) and not (labels.min() >= 0 and labels.max() < len(truth)):
        raise ValueError(f"detect returned a label that is not one of 0 to {len(truth) - 1}.")
    if item.scene.target.kind == "chessboard" and len(labels):
        labels = _nearest_symmetry(item, labels, points_px)
    size = item.scene.target.size
    deliverable = visible[size:] if markers and len(truth) > size else visible[:size]
    errors = points_px - truth[labels]
    away = np.linalg.norm(errors, axis=1)
    right = (away <= WRONG_PX) & visible[labels]
    _, first = np.unique(labels[right], return_index=True)  # a point delivered twice is found once
    kept = np.flatnonzero(right)[first]
    return Score(
        item, int(deliverable.sum()), int(np.sum(away > WRONG_PX)), labels[kept], errors[kept], seconds
    )


def rms_px(scores: Sequence[Score]) -> float:
    """Return the rms error of one coordinate over all points found, px; NaN without any."""
    errors = np.concatenate([s.errors_px for s in scores]) if scores else np.zeros((0, 2))
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else float("nan")


def found_fraction(scores: Sequence[Score]) -> float:
    """Return which fraction of the points in view was found."""
    asked = sum(s.asked for s in scores)
    return sum(len(s.labels) for s in scores) / asked if asked else float("nan")


def ratio_on_common(theirs: Sequence[Score], ours: Sequence[Score]) -> float:
    """Return the rms error of one detector over another's, of the points that both found.

    Where one delivers marker corners and the other grid points, of the images in which both found some. NaN without.
    """
    pairs = [(a, b) for a, b in zip(theirs, ours, strict=True) if len(a.labels) and len(b.labels)]
    if not pairs:
        return float("nan")
    squares = np.zeros(2)
    counts = np.zeros(2)
    same_kind = any(np.intersect1d(a.labels, b.labels).size for a, b in pairs)
    for a, b in pairs:
        _, at_a, at_b = np.intersect1d(a.labels, b.labels, return_indices=True)
        both = (a.errors_px[at_a], b.errors_px[at_b]) if same_kind else (a.errors_px, b.errors_px)
        squares += [float(np.sum(e**2)) for e in both]
        counts += [e.size for e in both]
    if not counts.all():
        return float("nan")
    mean = squares / counts
    return float(np.sqrt(mean[0] / mean[1]))


def _nearest_symmetry(item: Item, labels: np.ndarray, points_px: np.ndarray) -> np.ndarray:
    target = item.scene.target
    row, column = np.divmod(labels, target.columns)
    back, down = target.columns - 1 - column, target.rows - 1 - row
    choices = [r * target.columns + c for r in (row, down) for c in (column, back)]
    truth = item.truth_px
    return min(choices, key=lambda c: float(np.median(np.linalg.norm(points_px - truth[c], axis=1))))
