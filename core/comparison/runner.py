"""Run every method on the same images: the rows of Table II, and the poses of Table III.

The comparison itself does not fail: a method that fails on an image, or on all of them, reports it in its row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

from core.calibration import GroupEstimate, check_camera, check_points
from core.comparison.aruco import aruco_board, aruco_marker, central_marker, pose_of_points
from core.comparison.boby_saha import VARIANTS, proposed
from core.comparison.dlt import dlt
from core.comparison.five_points import five_points
from core.comparison.lines import lines
from core.comparison.opencv import opencv_single_image, zhang
from core.comparison.results import Answer, CameraOf, Failure, MethodResult, MethodRow, attempt
from core.comparison.tsai import tsai
from core.errors import (
    ADVISED_TILT,
    Advisory,
    DegenerateGeometry,
    GridposeError,
    InvalidArgument,
    TargetNotFound,
)
from core.geometry import Camera, invert, project, transform, transform_points
from core.targets import CharucoLayout, GridPoints, Markers, TargetSpec, charuco_layout

SINGLE_VIEW: dict[str, Callable[[GridPoints], MethodResult]] = {
    **{method: partial(proposed, method) for method in VARIANTS},
    "opencv_single_image": opencv_single_image,
    "tsai": tsai,
    "dlt": dlt,
    "five_points": five_points,
    "lines": lines,
}
METHODS = (
    *VARIANTS,
    "zhang",
    "opencv_single_image",
    "tsai",
    "dlt",
    "five_points",
    "lines",
    "aruco_marker",
    "aruco_board",
    "pooled",
)
"""The order of the rows."""
MARKER_METHODS = ("aruco_marker", "aruco_board")
ZHANG_VIEWS = 60
"""Views that `zhang` calibrates from at most, lest hundreds take minutes."""
MIN_POINTS = 6


def compare_methods(
    views: Sequence[GridPoints],
    pooled: GroupEstimate | Failure,
    *,
    markers: Sequence[Markers | None] | None = None,
    intrinsics: Camera | None = None,
    methods: Iterable[str] = METHODS,
) -> tuple[MethodRow, ...]:
    """Run every method: calibrate, or estimate poses where the method does not calibrate.

    Parameters
    ----------
    views
        The images of one camera setting (one focus group).
    pooled
        What `estimate_group` made of these very views with estimator `pooled`.
    markers
        The corners of the markers seen in each view, `GridPoints.markers_px` by default; None for a view of which they
        are not known.
    intrinsics
        The camera by which poses from markers are found; the pooled one by default.
    methods
        Those wanted; the rows are in the order of `METHODS`.

    Raises InvalidArgument for a method there is not.
    """
    wanted = set(methods)
    if not wanted <= set(METHODS):
        raise InvalidArgument(f"There are no methods {sorted(wanted - set(METHODS))}; choose of {METHODS}.")
    shown = [v.markers_px for v in views] if markers is None else list(markers)
    rows = []
    for method in METHODS:
        if method not in wanted:
            continue
        if method == "pooled":
            rows.append(_pooled_row(views, pooled))
        elif method == "zhang":
            rows.append(_zhang_row(views))
        elif method in MARKER_METHODS:
            rows.append(_marker_row(method, views, shown, intrinsics or _camera_of(pooled)))
        else:
            calibrate = SINGLE_VIEW[method]
            attempts = [_single(i, partial(calibrate, points)) for i, points in enumerate(views)]
            row = _row(method, "each_image", attempts)
            rows.append(replace(row, warnings=(_CENTRE_FREE,)) if method in VARIANTS and row.answers else row)
    return tuple(rows)


def evenly(count: int, at_most: int) -> list[int]:
    """Return at most so many of `count` places, evenly over all of them, the first and the last among them."""
    if count <= at_most:
        return list(range(count))
    return [round(i * (count - 1) / max(at_most - 1, 1)) for i in range(at_most)]


def _row(method: str, camera_of: CameraOf, outcomes: Iterable[Answer | Failure]) -> MethodRow:
    answers: list[Answer] = []
    failures: list[Failure] = []
    for outcome in outcomes:
        if isinstance(outcome, Answer):
            answers.append(outcome)
        else:
            failures.append(outcome)
    return MethodRow(method, camera_of, tuple(answers), tuple(failures))


def _single(image: int, calibrate: Callable[[], MethodResult]) -> Answer | Failure:
    return attempt(image, lambda: Answer((image,), calibrate()))


def _zhang_row(views: Sequence[GridPoints]) -> MethodRow:
    """Calibrate from a subset of many views, then place all views with its camera, as the calibration does."""
    failures: list[Failure] = []
    sound = []
    for i, points in enumerate(views):
        try:
            check_points(points)
            if len(points) < MIN_POINTS:
                raise DegenerateGeometry(
                    f"At least {MIN_POINTS} points are needed, {len(points)} were found."
                )
        except GridposeError as error:
            failures.append(Failure(i, error.code, error.detail, error.advice))
        else:
            sound.append(i)
    chosen = [sound[k] for k in evenly(len(sound), ZHANG_VIEWS)]
    answer = attempt(None, lambda: Answer(tuple(chosen), zhang([views[i] for i in chosen])))
    if isinstance(answer, Failure):
        return MethodRow("zhang", "all_images", (), (*failures, answer))
    if len(chosen) == len(sound):
        return MethodRow("zhang", "all_images", (answer,), tuple(failures))
    camera = answer.result.camera
    assert camera is not None, "attempt() lets no answer without a camera through"
    placed = [
        _single(i, partial(pose_of_points, "zhang", views[i].points_target, views[i].points_px, camera))
        for i in sound
    ]
    row = _row("zhang", "all_images", placed)
    warning = Advisory(
        "calibrated_from_subset",
        f"Calibrated from {len(chosen)} of {len(sound)} images, evenly over all of them in their order; the poses of "
        "all are found with that camera.",
    )
    return replace(row, failures=(*failures, *row.failures), warnings=(warning, *answer.result.warnings))


def _pooled_row(views: Sequence[GridPoints], estimate: GroupEstimate | Failure) -> MethodRow:
    if isinstance(estimate, Failure):
        return MethodRow("pooled", "all_images", (), (estimate,))
    camera = estimate.camera
    assert isinstance(camera, Camera), "the comparison pools with Brown's lens model"
    images = tuple(estimate.images.tolist())
    poses = [invert(transform(R, p)) for R, p in zip(estimate.rotations, estimate.positions_mm, strict=True)]
    residuals = [
        views[i].points_px - project(transform_points(T, views[i].points_target), camera)
        for i, T in zip(images, poses, strict=True)
    ]
    return MethodRow(
        "pooled",
        "all_images",
        (Answer(images, MethodResult("pooled", camera, tuple(poses), tuple(residuals))),),
        tuple(Failure(i, e.code, e.detail, e.advice) for i, e in estimate.failures),
        scatter=dict(zip(images, estimate.scatter, strict=True)),
    )


def _marker_row(
    method: str, views: Sequence[GridPoints], markers: Sequence[Markers | None], camera: Camera | Failure
) -> MethodRow:
    if isinstance(camera, Failure):
        return MethodRow(method, "given", (), (camera,))
    layouts: dict[TargetSpec, CharucoLayout] = {}

    def find(points: GridPoints, seen: Markers | None) -> MethodResult:
        check_camera(camera, points)
        if points.target not in layouts:
            layouts[points.target] = charuco_layout(points.target)
        layout = layouts[points.target]
        if method == "aruco_board":
            return aruco_board(seen or {}, layout, camera)
        marker = central_marker(layout)
        if marker not in (seen or {}):
            raise TargetNotFound(f"Marker {marker}, the one nearest to the board's middle, was not found.")
        assert seen is not None
        return aruco_marker(seen[marker], layout.marker_corners(marker), camera)

    outcomes: list[Answer | Failure] = []
    for i, (points, seen) in enumerate(zip(views, markers, strict=True)):
        if points.target.kind != "charuco":
            outcomes.append(Failure(i, *_WITHOUT_MARKERS))
        elif seen is None:
            outcomes.append(Failure(i, *_NOT_STORED))
        else:
            outcomes.append(_single(i, partial(find, points, seen)))
    return _row(method, "given", outcomes)


_CENTRE_FREE = Advisory(
    "principal_point_estimated",
    "Every image has a principal point of its own, which one image hardly separates from the camera's position: that "
    "is most of the scatter of these poses.",
    "For repeatability from single images hold it (repeatability?estimator=per_image_fixed_pp), or pool the images.",
)
_WITHOUT_MARKERS = (
    "target_without_markers",
    "The target has no ArUco markers.",
    "Use a ChArUco board (kind charuco): it has both, so that the methods are compared on the same images.",
)
_NOT_STORED = (
    "markers_not_stored",
    "The image was measured before markers were stored.",
    "Retry the measurement: markers are found and stored anew.",
)


def _camera_of(pooled: GroupEstimate | Failure) -> Camera | Failure:
    if isinstance(pooled, GroupEstimate):
        assert isinstance(pooled.camera, Camera), "the comparison pools with Brown's lens model"
        return pooled.camera
    return Failure(
        None,
        "intrinsics_missing",
        f"Poses from markers take a calibrated camera, and the pooled calibration gives none: {pooled.detail}",
        f"Give the session intrinsics, or add images with the target tilted by {ADVISED_TILT}.",
    )
