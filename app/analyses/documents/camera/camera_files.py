"""A focus group's camera as a file of OpenCV, ROS, Kalibr or mrcal.

Each format has its own lens models. A camera whose model it lacks is converted to the nearest of those it has
(`core.geometry.convert_camera`), over the radius that the images show. The file states the largest difference, px; one
over `MAX_ERROR_PX` is no file of this camera, and none is written. Pixel (0, 0) is the centre of the top-left pixel in
all four, as here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from app.analyses.outcome import AnalysisError
from app.errors import NotFound
from core.calibration import grade
from core.errors import Advisory
from core.geometry import LENS_PARAMETERS, Conversion, LensModel, convert_camera, lens_model_of
from core.session import (
    FocusGroup,
    SessionData,
    estimate_session,
    observed_radius,
    refine_target,
    with_print_uncertainty,
)

MAX_ERROR_PX = 0.5
RIM_POINTS = 36
INNER = 4  # fx, fy, cx, cy come first


@dataclass(frozen=True, slots=True)
class _Choice:
    """A lens model as a format names it: the order of its coefficients, and those that it lacks."""

    name: str
    model: LensModel
    coefficients: tuple[str, ...]
    absent: tuple[str, ...] = ()


_RATIONAL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_ANGULAR = ("k1", "k2", "k3", "k4")
_NO_TANGENTIAL = ("p1", "p2")
_CHOICES: Mapping[str, tuple[_Choice, ...]] = {
    "opencv": (
        _Choice("plumb_bob", "brown", ("k1", "k2", "p1", "p2", "k3")),
        _Choice("rational", "rational", _RATIONAL),
        _Choice("fisheye", "kannala_brandt", _ANGULAR, _NO_TANGENTIAL),
    ),
    "ros": (
        _Choice("plumb_bob", "brown", ("k1", "k2", "p1", "p2", "k3")),
        _Choice("rational_polynomial", "rational", _RATIONAL),
        _Choice("equidistant", "kannala_brandt", _ANGULAR, _NO_TANGENTIAL),
    ),
    "kalibr": (
        _Choice("radtan", "brown", ("k1", "k2", "p1", "p2"), ("k3",)),
        _Choice("equidistant", "kannala_brandt", _ANGULAR, _NO_TANGENTIAL),
    ),
    "mrcal": (
        _Choice("LENSMODEL_OPENCV5", "brown", ("k1", "k2", "p1", "p2", "k3")),
        _Choice("LENSMODEL_OPENCV8", "rational", _RATIONAL),
    ),
}
"""Of each format, simplest first: of several that represent the camera the first within a hundredth of a pixel."""
_GOOD_PX = 0.01


@dataclass(frozen=True, slots=True)
class _File:
    """What a file holds."""

    group: str
    width_px: int
    height_px: int
    choice: _Choice
    conversion: Conversion
    uncertainty_px: tuple[float, ...]
    """Standard uncertainties of fx, fy, cx, cy; that of f says the grade."""
    grade: str
    warnings: tuple[Advisory, ...]

    @property
    def inner(self) -> list[float]:
        """Return fx, fy, cx, cy."""
        return [float(value) for value in self.conversion.camera.as_array()[:INNER]]

    @property
    def matrix(self) -> list[float]:
        fx, fy, cx, cy = self.inner
        return [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]

    @property
    def coefficients(self) -> list[float]:
        names = LENS_PARAMETERS[self.choice.model]
        values = dict(zip(names, self.conversion.camera.as_array().tolist(), strict=True))
        return [float(values[name]) for name in self.choice.coefficients]

    @property
    def notes(self) -> list[str]:
        """Return what a reader has to know, a line each."""
        conversion = self.conversion
        return [
            "Camera by Gridpose; pixel (0, 0) is the centre of the top-left pixel.",
            f"largest_conversion_error_px: {conversion.largest_error_px:.2g}",
            f"valid_radius_px: {conversion.radius_px:.1f}  (about the principal point; not compared beyond it)",
            f"standard_uncertainty_px: {_listed([float(f'{u:.2g}') for u in self.uncertainty_px])}  "
            f"(of fx, fy, cx, cy; {self.grade})",
            *(f"warning: {one.code}: {' '.join(one.detail.split())}" for one in self.warnings),
        ]


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
    return _WRITERS[settings["format"]](_converted(group, settings["format"], estimate.warnings)).encode()


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


def _converted(group: FocusGroup, kind: str, warnings: tuple[Advisory, ...]) -> _File:
    """Return the camera in the first of the format's models that is good, or the best of them.

    Raises AnalysisError (`not_representable`), naming the formats that have a model which is good enough.
    """
    error, choice, conversion = _nearest(group, kind)
    if error <= MAX_ERROR_PX:
        estimate = group.estimate
        uncertainty = np.sqrt(np.maximum(np.diag(estimate.camera_covariance)[:INNER], 0.0))
        return _File(
            group.name,
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
    others = [one for one in _CHOICES if one != kind and _nearest(group, one)[0] <= MAX_ERROR_PX]
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


def _nearest(group: FocusGroup, kind: str) -> tuple[float, _Choice, Conversion]:
    """Return the largest error (px) of the first of a format's models that is good, or of the best; and the model."""
    camera, size = group.estimate.camera, _size(group)
    radius = observed_radius(group)
    own = lens_model_of(camera)
    best: tuple[float, _Choice, Conversion] | None = None
    for choice in sorted(_CHOICES[kind], key=lambda one: one.model != own):
        found = convert_camera(camera, choice.model, size, radius, choice.absent)
        if best is None or found.largest_error_px < best[0]:
            best = found.largest_error_px, choice, found
        if found.largest_error_px <= _GOOD_PX:
            break
    assert best is not None
    return best


def _listed(values: Sequence[float]) -> str:
    return "[" + ", ".join(f"{value:.10g}" for value in values) + "]"


def _commented(of: _File) -> list[str]:
    return [f"# {line}" for line in of.notes]


def _opencv(of: _File) -> str:
    """cv::FileStorage; flags of cv2.fisheye are needed where `distortion_model` says fisheye."""

    def matrix(name: str, rows: int, columns: int, values: Sequence[float]) -> list[str]:
        return [
            f"{name}: !!opencv-matrix",
            f"   rows: {rows}",
            f"   cols: {columns}",
            "   dt: d",
            f"   data: {_listed(values)}",
        ]

    conversion = of.conversion
    lines = [
        "%YAML:1.0",
        "---",
        *_commented(of),
        f"image_width: {of.width_px}",
        f"image_height: {of.height_px}",
        *matrix("camera_matrix", 3, 3, of.matrix),
        f"distortion_model: {of.choice.name}",
        *matrix("distortion_coefficients", 1, len(of.coefficients), of.coefficients),
        f"largest_conversion_error_px: {conversion.largest_error_px:.6g}",
        f"valid_radius_px: {conversion.radius_px:.6g}",
    ]
    return "\n".join(lines) + "\n"


def _ros(of: _File) -> str:
    """As sensor_msgs/CameraInfo is stored by camera_calibration and read by camera_calibration_parsers."""
    fx, fy, cx, cy = of.inner

    def matrix(name: str, rows: int, columns: int, values: Sequence[float]) -> list[str]:
        return [f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: {_listed(values)}"]

    lines = [
        *_commented(of),
        f"image_width: {of.width_px}",
        f"image_height: {of.height_px}",
        "camera_name: gridpose",
        *matrix("camera_matrix", 3, 3, of.matrix),
        f"distortion_model: {of.choice.name}",
        *matrix("distortion_coefficients", 1, len(of.coefficients), of.coefficients),
        *matrix("rectification_matrix", 3, 3, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        *matrix("projection_matrix", 3, 4, [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
    ]
    return "\n".join(lines) + "\n"


def _kalibr(of: _File) -> str:
    """A camchain of one camera."""
    lines = [
        *_commented(of),
        "cam0:",
        "  camera_model: pinhole",
        f"  intrinsics: {_listed(of.inner)}",
        f"  distortion_model: {of.choice.name}",
        f"  distortion_coeffs: {_listed(of.coefficients)}",
        f"  resolution: [{of.width_px}, {of.height_px}]",
        "  rostopic: /cam0/image_raw",
    ]
    return "\n".join(lines) + "\n"


def _mrcal(of: _File) -> str:
    """A .cameramodel: a Python literal, its region of valid intrinsics the disc that the images cover."""
    rim = ", ".join(f"[{u:.2f}, {v:.2f}]" for u, v in _rim(of))
    lines = [
        *_commented(of),
        "{",
        f"    'lensmodel': '{of.choice.name}',",
        f"    'intrinsics': {_listed([*of.inner, *of.coefficients])},",
        f"    'valid_intrinsics_region': [{rim}],",
        "    'extrinsics': [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],",
        f"    'imagersize': [{of.width_px}, {of.height_px}],",
        "}",
    ]
    return "\n".join(lines) + "\n"


def _rim(of: _File) -> list[tuple[float, float]]:
    """Return a closed contour: the rim of the disc, within the image."""
    _, _, cx, cy = of.inner
    points = []
    for k in range(RIM_POINTS + 1):
        angle = 2.0 * math.pi * (k % RIM_POINTS) / RIM_POINTS
        u, v = cx + of.conversion.radius_px * math.cos(angle), cy + of.conversion.radius_px * math.sin(angle)
        points.append((min(max(u, 0.0), of.width_px - 1.0), min(max(v, 0.0), of.height_px - 1.0)))
    return points


_WRITERS: Mapping[str, Callable[[_File], str]] = {
    "opencv": _opencv,
    "ros": _ros,
    "kalibr": _kalibr,
    "mrcal": _mrcal,
}
