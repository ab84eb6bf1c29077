"""Cameras written as files of OpenCV, ROS, Kalibr or mrcal, and the lens models that each of these formats has."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from core.errors import Advisory
from core.geometry import LENS_PARAMETERS, Conversion, LensModel

RIM_POINTS = 36
INNER = 4  # fx, fy, cx, cy come first


@dataclass(frozen=True, slots=True)
class LensForm:
    """A lens model as a format names it: the order of its coefficients, and those that it lacks."""

    name: str
    model: LensModel
    coefficients: tuple[str, ...]
    absent: tuple[str, ...] = ()


_RATIONAL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_ANGULAR = ("k1", "k2", "k3", "k4")
_NO_TANGENTIAL = ("p1", "p2")
LENS_FORMS: Mapping[str, tuple[LensForm, ...]] = {
    "opencv": (
        LensForm("plumb_bob", "brown", ("k1", "k2", "p1", "p2", "k3")),
        LensForm("rational", "rational", _RATIONAL),
        LensForm("fisheye", "kannala_brandt", _ANGULAR, _NO_TANGENTIAL),
    ),
    "ros": (
        LensForm("plumb_bob", "brown", ("k1", "k2", "p1", "p2", "k3")),
        LensForm("rational_polynomial", "rational", _RATIONAL),
        LensForm("equidistant", "kannala_brandt", _ANGULAR, _NO_TANGENTIAL),
    ),
    "kalibr": (
        LensForm("radtan", "brown", ("k1", "k2", "p1", "p2"), ("k3",)),
        LensForm("equidistant", "kannala_brandt", _ANGULAR, _NO_TANGENTIAL),
    ),
    "mrcal": (
        LensForm("LENSMODEL_OPENCV5", "brown", ("k1", "k2", "p1", "p2", "k3")),
        LensForm("LENSMODEL_OPENCV8", "rational", _RATIONAL),
    ),
}
"""Of each format, simplest first: of several that represent the camera the first within a hundredth of a pixel."""


@dataclass(frozen=True, slots=True)
class CameraFile:
    """What a file holds."""

    width_px: int
    height_px: int
    choice: LensForm
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


def _listed(values: Sequence[float]) -> str:
    return "[" + ", ".join(map(_number, values)) + "]"


def _number(value: float) -> str:
    """Return ten digits with a point: without one, 1e-05 is a text in YAML 1.1."""
    mantissa, e, exponent = f"{value:.10g}".partition("e")
    return (mantissa if "." in mantissa else f"{mantissa}.0") + e + exponent


def _commented(of: CameraFile) -> list[str]:
    return [f"# {line}" for line in of.notes]


def _opencv(of: CameraFile) -> str:
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


def _ros(of: CameraFile) -> str:
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


def _kalibr(of: CameraFile) -> str:
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


def _mrcal(of: CameraFile) -> str:
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


def _rim(of: CameraFile) -> list[tuple[float, float]]:
    """Return a closed contour: the rim of the disc, within the image."""
    _, _, cx, cy = of.inner
    points = []
    for k in range(RIM_POINTS + 1):
        angle = 2.0 * math.pi * (k % RIM_POINTS) / RIM_POINTS
        u, v = cx + of.conversion.radius_px * math.cos(angle), cy + of.conversion.radius_px * math.sin(angle)
        points.append((min(max(u, 0.0), of.width_px - 1.0), min(max(v, 0.0), of.height_px - 1.0)))
    return points


WRITERS: Mapping[str, Callable[[CameraFile], str]] = {
    "opencv": _opencv,
    "ros": _ros,
    "kalibr": _kalibr,
    "mrcal": _mrcal,
}
