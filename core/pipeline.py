"""Calibration of one image from its bytes, for one target or several."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from scipy.spatial import cKDTree

from core.calibration import Calibration, Lens, calibrate_points
from core.errors import Advisory, GridposeError, TargetAmbiguous, TargetMismatch
from core.geometry import Camera
from core.image import DEFAULT_MAX_PIXELS, decode
from core.targets import GridPoints, TargetSpec, assess_capture, detect, look_for, with_tilt

_NUMBERED_KINDS = ("charuco", "aprilgrid")
"""Kinds whose points are identified by the markers' numbers: no other grid is mistaken for them."""
_SAME_POINT_PX = 2.0
_SAME_GRID = 0.5
"""Share of the smaller one's points above which two finds are of the same grid."""
_MANY_MORE = 1.08  # times as many points: a line more, of grids of up to a dozen lines


@dataclass(frozen=True, slots=True)
class TargetOutcome:
    """Outcome for one target that an image was searched for: its calibration, or the failure.

    `failure.points` distinguishes a target that is in view and was refused from one that was not found.
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

    The points carry the quality of the image (`GridPoints.capture_quality`).

    Decoding and search are done on return, each calibration when its outcome is asked for. Where the same points of
    the image are found as several targets, they are assigned to the one whose markers have numbers, then to the one
    that has clearly more points there, then to the one that is wholly in view. If none of these decides, all of the
    targets fail with TargetAmbiguous, and other targets in view carry the warning `target_ambiguous`.

    Raises the leaves of ImageError; every other failure is the outcome of one target.
    """
    image = decode(data, max_pixels=max_pixels)
    finds: list[GridPoints | GridposeError] = []
    # With several targets another one may be in view rightly, so that its presence explains no failure.
    find = look_for if len(targets) == 1 else detect
    for target in targets:
        try:
            found = find(image, target)
            finds.append(dataclasses.replace(found, capture_quality=assess_capture(image, found)))
        except GridposeError as failure:
            finds.append(failure)
    return _calibrated(targets, _assign_points(finds), lens, intrinsics)


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
    """Return the calibration with its own tilt in the image's quality, in place of that of a typical lens."""
    points = calibration.points
    if points.capture_quality is None:
        return calibration
    quality = with_tilt(points.capture_quality, calibration.observability.tilt)
    return dataclasses.replace(calibration, points=dataclasses.replace(points, capture_quality=quality))


def _assign_points(finds: Sequence[GridPoints | GridposeError]) -> list[GridPoints | GridposeError]:
    """Return the finds with every grid of the image assigned to at most one target."""
    assigned = list(finds)
    ambiguous: set[int] = set()
    for i, one in enumerate(finds):
        for j, other in enumerate(finds[:i]):
            if isinstance(one, GridposeError) or isinstance(other, GridposeError):
                continue
            if not _same_grid(one, other):
                continue
            first, second = _precedence(one, other), _precedence(other, one)
            if first == second:
                ambiguous |= {i, j}
            else:
                loser, winner = (i, other) if first < second else (j, one)
                assigned[loser] = TargetMismatch(
                    f"The grid in view that this target was found in is another one: {_described(winner.target)}."
                )
    ambiguous = {k for k in ambiguous if not isinstance(assigned[k], GridposeError)}
    if not ambiguous:
        return assigned
    candidates = [
        find.target for k, find in enumerate(finds) if k in ambiguous and isinstance(find, GridPoints)
    ]
    listed = ", ".join(map(_described, candidates))
    for k in ambiguous:
        assigned[k] = TargetAmbiguous(f"The grid in view may be any of these, which look the same: {listed}.")
    warning = Advisory(
        "target_ambiguous",
        f"The image shows another grid, too, that may be any of these, which look the same: {listed}.",
        TargetAmbiguous.default_advice,
    )
    return [
        find
        if isinstance(find, GridposeError)
        else dataclasses.replace(find, warnings=(*find.warnings, warning))
        for find in assigned
    ]


def _precedence(points: GridPoints, other: GridPoints) -> tuple[bool, bool, bool]:
    """Return the precedence of a target over another one for points that both fit; the larger wins.

    A target that explains many more points is not a smaller one that is wholly in view: what lies across a board may
    leave as much of it on one side as the smaller one has.
    """
    numbered = points.target.kind in _NUMBERED_KINDS
    return numbered, len(points) > _MANY_MORE * len(other), len(points) == points.target.size


def _same_grid(one: GridPoints, other: GridPoints) -> bool:
    """Return whether two finds are at the same places of the image."""
    few, many = sorted((one.points_px, other.points_px), key=len)
    apart, _ = cKDTree(many).query(few, distance_upper_bound=_SAME_POINT_PX)  # infinite beyond it
    return float((apart < _SAME_POINT_PX).mean()) > _SAME_GRID


def _described(target: TargetSpec) -> str:
    return f"{target.kind} {target.columns} x {target.rows} of {target.pitch_mm:g} mm"
