"""Each view of a focus group with a camera of its own."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from core.calibration.fixed_centre import fit_fixed_centre
from core.calibration.group_fits import Fitted, first_failure
from core.calibration.group_pooled import CONTRADICTION, lens_contradiction
from core.calibration.model import LENS_PRIOR, Lens, View, centred, image_centre
from core.calibration.same_points import fit_again, points_in_common
from core.calibration.shared_lens import linearise
from core.calibration.single_image import FOCAL_GATE, calibrate_points
from core.calibration.view_stack import ViewStack, stack_states
from core.camera import Camera
from core.errors import Advisory, FocalNotObservable, GridposeError, NotConverged
from core.targets.specification import GridPoints


def fit_each(
    views: ViewStack,
    labels: Int[np.ndarray, " m"],
    estimator: str,
    lens: Lens | None,
    intrinsics: Camera | None,
    failures: dict[int, GridposeError],
) -> Fitted:
    """Fit every view by itself, then again with the points that its pose's views have in common."""
    images: list[int] = []
    states: list[View] = []
    used: list[Bool[np.ndarray, " _"]] = []
    contradicted: list[bool] = []
    for i in range(len(views)):
        points = views.view(i)
        try:
            if estimator == "per_image":
                found = calibrate_points(points, lens=lens)
                rotation = found.T_camera_target[:3, :3]
                centroid = rotation @ centred(points)[1] + found.T_camera_target[:3, 3]
                state, counted = View(found.camera.as_array(), rotation, centroid), found.used
                against = any(w.code == "lens_prior_contradicted" for w in found.warnings)
            else:
                state, counted, against = _fixed_centre(points, lens, intrinsics)
        except GridposeError as failure:
            failures[i] = failure
            continue
        images.append(i)
        states.append(state)
        used.append(counted)
        contradicted.append(against)
    if not images:
        raise first_failure(failures)
    warnings = _contradictions(lens, states, contradicted)
    chosen, repeats = views.take(images), labels[images]
    flat = np.concatenate(used)
    at = linearise(chosen, stack_states(states), flat)
    common = points_in_common(chosen, at, repeats)
    if np.array_equal(flat, common):
        return Fitted(estimator, images, chosen, repeats, at, flat, None, warnings)
    for k, i in enumerate(images):
        counted = common[chosen.part(k)]
        if np.array_equal(used[k], counted):
            continue
        try:
            states[k] = fit_again(
                chosen.view(k),
                states[k],
                counted,
                centre_held=estimator == "per_image_fixed_pp",
                lens=None if contradicted[k] else lens,
            )
        except NotConverged as failure:
            failures[i] = failure
    left = [k for k, i in enumerate(images) if i not in failures]
    if not left:
        raise first_failure(failures)
    flat = np.concatenate([common[chosen.part(k)] for k in left])
    rest = chosen.take(left)
    at = linearise(rest, stack_states([states[k] for k in left]), flat)
    return Fitted(estimator, [images[k] for k in left], rest, repeats[left], at, flat, None, warnings)


def _contradictions(
    lens: Lens | None, states: Sequence[View], contradicted: Sequence[bool]
) -> tuple[Advisory, ...]:
    if lens is None or not any(contradicted):
        return ()
    focals = [0.5 * float(v.parameters[:2].sum()) for v, c in zip(states, contradicted, strict=True) if c]
    share = f" of {len(focals)} of {len(states)} images"
    return (lens_contradiction(lens, float(np.median(focals)), share),)


def _fixed_centre(
    points: GridPoints, lens: Lens | None, intrinsics: Camera | None
) -> tuple[View, Bool[np.ndarray, " n"], bool]:
    """Return the view, the points that count, and whether it contradicts the lens."""
    centre = image_centre(points) if intrinsics is None else (intrinsics.cx_px, intrinsics.cy_px)
    result = fit_fixed_centre(points, centre, lens)
    focal = float(result.state.parameters[0])
    u = math.sqrt(max(float(result.covariance[0, 0]), 0.0)) / focal
    if u > FOCAL_GATE:
        raise FocalNotObservable(
            f"The focal length is uncertain by {100.0 * u:.1f} % in this view; the limit is {100.0 * FOCAL_GATE:g} %."
        )
    against = lens is not None and abs(math.log(lens.focal_px / focal)) > CONTRADICTION * math.hypot(
        LENS_PRIOR, u
    )
    return result.state, result.used, against
