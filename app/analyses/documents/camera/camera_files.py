"""A focus group's camera as a file of OpenCV, ROS, Kalibr or mrcal.

Each format has its own lens models. A camera whose model it lacks is converted to the nearest of those it has
(`core.geometry.convert_camera`), over the radius that the images show. The file states the largest difference, px; one
over `MAX_ERROR_PX` is no file of this camera, and none is written. Pixel (0, 0) is the centre of the top-left pixel in
all four, as here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np

from app.analyses.documents.camera.camera_formats import INNER, LENS_FORMS, WRITERS, CameraFile, LensForm
from app.analyses.outcome import AnalysisError
from app.errors import NotFound
from core.calibration import grade
from core.errors import Advisory
from core.geometry import Conversion, LensModel, convert_camera, lens_model_of
from core.session import (
    FocusGroup,
    SessionData,
    estimate_session,
    observed_radius,
    refine_target,
    with_print_uncertainty,
)

MAX_ERROR_PX = 0.5
_GOOD_PX = 0.01
"""Of several of a format's models that represent the camera, the first within this is taken."""


def camera_file(data: SessionData, settings: Mapping[str, str]) -> bytes:
    """Return what `GET .../intrinsics/export` answers.

    Raises AnalysisError where the focus group is not stated and there are several, is not the session's, or where
    the format has no lens model for the camera.
    """
    asked = cast("LensModel | None", settings.get("lens_model"))  # the route admits no other names
    estimate = estimate_session(data, settings["estimator"], asked)
    if settings.get("refine_target") == "true":
        estimate = refine_target(data, estimate).estimate
    estimate = with_print_uncertainty(data, estimate)
    group = chosen_group(data, estimate.groups, settings.get("focus_group"))
    return WRITERS[settings["format"]](_converted(group, settings["format"], estimate.warnings)).encode()


def chosen_group(data: SessionData, groups: Sequence[FocusGroup], wanted: str | None) -> FocusGroup:
    """Return the focus group of this name, or the only one; raises AnalysisError or NotFound."""
    if wanted is None and len(groups) == 1:
        return groups[0]
    found = [group for group in groups if group.name == wanted]
    if found:
        return found[0]
    names = ", ".join(repr(group.name) for group in groups)
    if wanted is None:
        raise AnalysisError(
            "focus_group_required",
            f"The session has a camera for each of its focus groups, {names}; one is asked for.",
            "Name one of them (`focus_group`).",
        )
    if wanted not in {image.focus_group for image in data.images}:
        raise NotFound(
            "None of the session's measured images is of that focus group.",
            "Name one that the session's intrinsics list (GET .../intrinsics).",
            code="focus_group_not_found",
        )
    raise AnalysisError(
        "no_usable_images",
        f"The images of focus group {wanted!r} give no camera.",
        "Look at the images that the session's intrinsics exclude, with their reasons (GET .../intrinsics).",
    )


def _converted(group: FocusGroup, kind: str, warnings: tuple[Advisory, ...]) -> CameraFile:
    """Return the camera in the first of the format's models that is good, or the best of them.

    Raises AnalysisError (`not_representable`), naming the formats that have a model which is good enough.
    """
    error, choice, conversion = _nearest(group, kind)
    if error <= MAX_ERROR_PX:
        estimate = group.estimate
        uncertainty = np.sqrt(np.maximum(np.diag(estimate.camera_covariance)[:INNER], 0.0))
        return CameraFile(
            *_size(group),
            choice,
            conversion,
            tuple(uncertainty.tolist()),
            grade(estimate.focal_relative_uncertainty),
            warnings,
        )
    off = (
        "have no pixels at all in part of the image"
        if math.isinf(error)
        else f"are off by up to {error:.2g} px"
    )
    others = [one for one in LENS_FORMS if one != kind and _nearest(group, one)[0] <= MAX_ERROR_PX]
    json = "the JSON of the intrinsics, which has the camera as it is"
    raise AnalysisError(
        "not_representable",
        f"No lens model of {kind} represents this camera ({lens_model_of(group.estimate.camera)}): pixels of the "
        f"nearest, {choice.name}, {off}; the limit is {MAX_ERROR_PX:g} px.",
        f"Take {' or '.join(others)}, or {json}."
        if others
        else f"Take {json}: no other format represents it either.",
    )


def _size(group: FocusGroup) -> tuple[int, int]:
    return group.views.image_width_px, group.views.image_height_px


def _nearest(group: FocusGroup, kind: str) -> tuple[float, LensForm, Conversion]:
    """Return the largest error (px) of the first of a format's models that is good, or of the best; and the model."""
    camera, size = group.estimate.camera, _size(group)
    radius = observed_radius(group)
    own = lens_model_of(camera)
    best: tuple[float, LensForm, Conversion] | None = None
    for choice in sorted(LENS_FORMS[kind], key=lambda one: one.model != own):
        found = convert_camera(camera, choice.model, size, radius, choice.absent)
        if best is None or found.largest_error_px < best[0]:
            best = found.largest_error_px, choice, found
        if found.largest_error_px <= _GOOD_PX:
            break
    assert best is not None
    return best
