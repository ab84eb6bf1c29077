"""The session's cameras once more, before the target as it really is: its shape from the images themselves.

The shape is estimated from one focus group's images of one target, those of which there are most, and then taken for
every image of that target. What the shape leaves open of the camera is added to the covariance of that group's.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from app.records.codec import decode_points
from app.services.analyses.estimation import EstimatedImage, FocusGroup, SessionEstimate
from app.services.analyses.snapshot import Snapshot
from core import Advisory, Camera, Lens, TargetSpec
from core.calibration.estimators import estimate_group
from core.calibration.readings import turns_alike
from core.calibration.shape_departures import Departure, Measure
from core.calibration.target_shape import TargetShape, estimate_target_shape
from core.targets.specification import GridPoints
from core.transforms import invert, transform_points

MOST_IMAGES = 120
"""Of which a shape is estimated; more are thinned evenly, since images of one pose tell the same."""


@dataclass(frozen=True, slots=True)
class Refined:
    """The focus groups before the refined target, and the shape as a document."""

    groups: tuple[FocusGroup, ...]
    images: tuple[EstimatedImage, ...]
    shape: dict[str, Any]
    warnings: tuple[Advisory, ...]


def refine_target(snapshot: Snapshot, points: Mapping[str, bytes], session: SessionEstimate) -> Refined:
    """Estimate the shape of the target that most images show, and the cameras again with it.

    Raises TargetShapeNotObservable where the images do not tell it.
    """
    counts = Counter((e.image.target, group.name) for group in session.groups for e in group.images)
    target, name = min(counts, key=lambda key: (-counts[key], key))
    views = {group.name: _views(snapshot, points, group) for group in session.groups}
    group = next(g for g in session.groups if g.name == name)
    shown = [k for k, e in enumerate(group.images) if e.image.target == target]
    chosen = [shown[i] for i in _spread(len(shown))]
    shape = estimate_target_shape([views[name][k] for k in chosen], lens=_lens(snapshot))
    document = _document(shape, snapshot.target_ids[target], name, len(chosen))
    warnings: list[Advisory] = []
    if len(snapshot.targets) > 1:
        warnings.append(
            Advisory(
                "one_target_refined",
                f"The shape of target {snapshot.target_ids[target]} was estimated, which most images show; the others "
                "are taken as perfect.",
                "Put images of each target into a session of their own to refine it.",
            )
        )
    if not document["applied"]:
        return Refined(session.groups, session.images, document, tuple(warnings))
    spec = TargetSpec(**snapshot.targets[target])
    groups = []
    for old in session.groups:
        if all(e.image.target != target for e in old.images):
            groups.append(old)
            continue
        of_shape = shape.shape_covariance if old.name == name else np.zeros((9, 9))
        groups.append(_again(snapshot, old, [_on(shape, spec, v) for v in views[old.name]], of_shape))
    others = [g.name for g in groups if g.name != name]
    if others:
        warnings.append(
            Advisory(
                "shape_doubt_left_out",
                f"The shape comes from focus group {name!r}; the uncertainties of {', '.join(map(repr, others))} do "
                "not hold what it leaves open.",
                None,
            )
        )
    left = sum(len(old.images) - len(new.images) for old, new in zip(session.groups, groups, strict=True))
    if left:
        warnings.append(
            Advisory(
                "images_not_refined",
                f"{left} images could not be estimated again before the refined target, and are not in its figures.",
                "Look at the overlays of the worst images.",
            )
        )
    place = {e.image.measurement_id: i for i, e in enumerate(session.images)}
    images = sorted((e for g in groups for e in g.images), key=lambda e: place[e.image.measurement_id])
    return Refined(tuple(groups), tuple(images), document, tuple(warnings))


def _views(snapshot: Snapshot, points: Mapping[str, bytes], group: FocusGroup) -> list[GridPoints]:
    """Return the group's grid points, those of boards that look the same when turned under the names of one reading."""
    specs = [TargetSpec(**target) for target in snapshot.targets]
    turns = [turns_alike(spec) for spec in specs]
    views = []
    for k, e in enumerate(group.images):
        image = e.image
        view = decode_points(
            points[image.measurement_id], [], specs[image.target], image.width_px, image.height_px
        )
        back = group.estimate.rotations[k] @ e.rotation.T  # R_read = R_turn R
        of_target = turns[image.target]
        turn = int(np.argmax([np.sum(T[:3, :3] * back) for T in of_target]))
        views.append(_renamed(view, of_target[turn]) if turn else view)
    return views


def _renamed(view: GridPoints, turn: Float[np.ndarray, "4 4"]) -> GridPoints:
    """Return the same points under the names they have after a turn of the grid."""
    places = transform_points(invert(turn), view.points_target)
    grid = view.target.points_target()
    index = np.argmin(np.sum((places[:, None] - grid) ** 2, axis=2), axis=1)
    row, column = np.divmod(index, view.target.columns)
    return replace(view, column=column, row=row)


def _on(shape: TargetShape, target: TargetSpec, view: GridPoints) -> GridPoints:
    return shape.applied(view) if view.target == target else view


def _spread(count: int) -> list[int]:
    """Return indices of at most `MOST_IMAGES`, evenly from all; images are in the order of their poses."""
    if count <= MOST_IMAGES:
        return list(range(count))
    return np.unique(np.linspace(0, count - 1, MOST_IMAGES).round().astype(int)).tolist()


def _lens(snapshot: Snapshot) -> Lens | None:
    return Lens(**snapshot.lens) if snapshot.lens is not None else None


def _again(
    snapshot: Snapshot, old: FocusGroup, views: Sequence[GridPoints], of_shape: Float[np.ndarray, "9 9"]
) -> FocusGroup:
    """Estimate a group's camera and poses from these views of its images."""
    repeats: list[Hashable] = [(e.image.pose_id, e.image.target) for e in old.images]
    estimate = estimate_group(
        views,
        old.estimate.estimator,
        lens=_lens(snapshot),
        intrinsics=Camera(**snapshot.intrinsics) if snapshot.intrinsics is not None else None,
        repeats=repeats,
    )
    if estimate.estimator != "given":
        estimate = replace(estimate, camera_covariance=estimate.camera_covariance + of_shape)
    images = tuple(
        EstimatedImage(
            old.images[i].image,
            estimate.positions_mm[k],
            estimate.rotations[k],
            estimate.covariance[k],
            estimate.scatter[k],
            estimate.common[k],
            float(estimate.rms_px[k]),
        )
        for k, i in enumerate(estimate.images.tolist())
    )
    return FocusGroup(old.name, estimate, images)


def _document(shape: TargetShape, target_id: str, focus_group: str, images: int) -> dict[str, Any]:
    degrees = math.degrees(1.0)
    shear = Measure(degrees * shape.shear.value, degrees * shape.shear.standard_uncertainty)
    return {
        "target_id": target_id,
        "focus_group": focus_group,
        "images": images,
        "directions": shape.directions,
        "applied": shape.in_plane.significant or shape.out_of_plane.significant,
        "rms_before_px": shape.rms_before_px,
        "rms_px": shape.rms_px,
        "reduced_chi2": shape.reduced_chi2,
        "in_plane": _departure(shape.in_plane),
        "out_of_plane": _departure(shape.out_of_plane),
        "bow_x_mm": _measure(shape.bow_x_mm),
        "bow_y_mm": _measure(shape.bow_y_mm),
        "twist_mm": _measure(shape.twist_mm),
        "aspect": _measure(shape.aspect),
        "shear_deg": _measure(shear),
        "points": [
            {"column": column, "row": row, "departure_mm": departure, "standard_uncertainty_mm": u}
            for column, row, departure, u in zip(
                shape.column.tolist(),
                shape.row.tolist(),
                shape.departures_mm.tolist(),
                shape.standard_uncertainty_mm.tolist(),
                strict=True,
            )
        ],
    }


def _departure(departure: Departure) -> dict[str, Any]:
    return {
        "rms_mm": departure.rms_mm,
        "standard_uncertainty_mm": departure.standard_uncertainty_mm,
        "noise_mm": departure.noise_mm,
        "largest_mm": departure.largest_mm,
        "significant": departure.significant,
    }


def _measure(measure: Measure) -> dict[str, float]:
    return {"value": measure.value, "standard_uncertainty": measure.standard_uncertainty}
