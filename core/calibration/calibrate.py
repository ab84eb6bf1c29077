"""The public door: bytes of one image in, its calibration out."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from scipy.spatial import cKDTree

from core.calibration.model import Lens
from core.calibration.result import Calibration
from core.calibration.single_image import calibrate_points
from core.camera import Camera
from core.errors import Advisory, GridposeError, TargetAmbiguous, TargetMismatch
from core.image import DEFAULT_MAX_PIXELS, decode
from core.targets.capture import assess_capture, with_tilt
from core.targets.detect import detect
from core.targets.shown_instead import look_for
from core.targets.specification import GridPoints, TargetSpec

_NUMBERED_KINDS = ("charuco", "aprilgrid")
"""Kinds whose points are told by the markers' numbers: no other grid is taken for them."""
_SAME_POINT_PX = 2.0
_SAME_GRID = 0.5
"""Share of the smaller one's points above which two finds are of the same grid."""


@dataclass(frozen=True, slots=True)
class TargetOutcome:
    """What came of one target that an image was searched for: its calibration, or why there is none.

    `failure.points` tells a target that is in view and was refused from one that was not found.
    """

    target: TargetSpec
    calibration: Calibration | None
    failure: GridposeError | None


def calibrate_image(
    data: bytes,
    target: TargetSpec,
    *,
    lens: Lens | None = None,
    intrinsics: Camera | None = None,
    max_pixels: int = DEFAULT_MAX_PIXELS,
) -> Calibration:
    """Decode one image, find the target in it, and calibrate camera and pose from it.

    `data` is a whole PNG, JPEG, TIFF or BMP file. EXIF orientation is ignored: pixels are the sensor's.

    Raises the leaves of ImageError, DetectionError and EstimationError (`core.errors`); those raised after
    grid points were found carry them as `.points`.
    """
    points = look_for(decode(data, max_pixels=max_pixels), target)
    return calibrate_points(points, lens=lens, intrinsics=intrinsics)


def calibrate_targets(
    data: bytes,
    targets: Sequence[TargetSpec],
    *,
    lens: Lens | None = None,
    intrinsics: Camera | None = None,
    max_pixels: int = DEFAULT_MAX_PIXELS,
) -> Iterator[TargetOutcome]:
    """Decode one image, look for each of several targets in it, and return an outcome for each, in the order given.

    The points carry how well the picture was taken (`GridPoints.capture_quality`).

    Decoding and search are done on return, each calibration when its outcome is asked for. Where the same points of
    the picture are found as several targets, the one whose markers have numbers is meant, then the one that is wholly
    in view; grids that nothing tells apart fail with TargetAmbiguous, all of them, and what else is in view says so.

    Raises the leaves of ImageError; all else that can go wrong is the outcome of one target.
    """
    image = decode(data, max_pixels=max_pixels)
    finds: list[GridPoints | GridposeError] = []
    find = look_for if len(targets) == 1 else detect
    for target in targets:
        try:
            found = find(image, target)
            finds.append(dataclasses.replace(found, capture_quality=assess_capture(image, found)))
        except GridposeError as failure:
            finds.append(failure)
    return _calibrated(targets, _tell_apart(finds), lens, intrinsics)


def _calibrated(
    targets: Sequence[TargetSpec],
    finds: Sequence[GridPoints | GridposeError],
    lens: Lens | None,
    intrinsics: Camera | None,
) -> Iterator[TargetOutcome]:
    for target, find in zip(targets, finds, strict=True):
        if isinstance(find, GridposeError):
            yield TargetOutcome(target, None, find)
            continue
        try:
            calibration = calibrate_points(find, lens=lens, intrinsics=intrinsics)
        except GridposeError as failure:
            yield TargetOutcome(target, None, failure)
        else:
            yield TargetOutcome(target, _with_its_tilt(calibration), None)


def _with_its_tilt(calibration: Calibration) -> Calibration:
    """Return the calibration with its own tilt in the picture's quality, in place of a usual lens's."""
    points = calibration.points
    if points.capture_quality is None:
        return calibration
    quality = with_tilt(points.capture_quality, calibration.observability.tilt)
    return dataclasses.replace(calibration, points=dataclasses.replace(points, capture_quality=quality))


def _tell_apart(finds: Sequence[GridPoints | GridposeError]) -> list[GridPoints | GridposeError]:
    """Return the finds with every grid of the picture taken for one target at most."""
    told = list(finds)
    doubtful: set[int] = set()
    for i, one in enumerate(finds):
        for j, other in enumerate(finds[:i]):
            if isinstance(one, GridposeError) or isinstance(other, GridposeError):
                continue
            if not _same_grid(one, other):
                continue
            if _claim(one) == _claim(other):
                doubtful |= {i, j}
            else:
                loser, winner = (i, other) if _claim(one) < _claim(other) else (j, one)
                told[loser] = TargetMismatch(
                    f"The grid in view that this target was found in is another one: {_described(winner.target)}."
                )
    doubtful = {k for k in doubtful if not isinstance(told[k], GridposeError)}
    if not doubtful:
        return told
    alike = [find.target for k, find in enumerate(finds) if k in doubtful and isinstance(find, GridPoints)]
    listed = ", ".join(map(_described, alike))
    for k in doubtful:
        told[k] = TargetAmbiguous(f"The grid in view may be any of these, which look alike: {listed}.")
    remark = Advisory(
        "target_ambiguous",
        f"The image shows another grid, too, that may be any of these, which look alike: {listed}.",
        TargetAmbiguous.default_advice,
    )
    return [
        find
        if isinstance(find, GridposeError)
        else dataclasses.replace(find, warnings=(*find.warnings, remark))
        for find in told
    ]


def _claim(points: GridPoints) -> tuple[bool, bool, bool]:
    """Return how well founded it is that these points are this target's: the larger, the better."""
    numbered = points.target.kind in _NUMBERED_KINDS
    return numbered, len(points) == points.target.size, points.origin != "unknown"


def _same_grid(one: GridPoints, other: GridPoints) -> bool:
    """Tell whether two finds are at the same places of the picture."""
    few, many = sorted((one.points_px, other.points_px), key=len)
    apart, _ = cKDTree(many).query(few, distance_upper_bound=_SAME_POINT_PX)  # infinite beyond it
    return float((apart < _SAME_POINT_PX).mean()) > _SAME_GRID


def _described(target: TargetSpec) -> str:
    return f"{target.kind} {target.columns} x {target.rows} of {target.pitch_mm:g} mm"
