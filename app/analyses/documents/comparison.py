"""Every method on the same images, as the paper compares them: its Tables II (calibration) and III (repeatability)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from app.analyses.documents.encoding import figures_document
from app.analyses.documents.findings import Findings
from app.analyses.inputs.session_loader import Markers
from core import Advisory, GridposeError
from core.comparison import (
    Failure,
    MethodPose,
    MethodRepeatability,
    MethodRow,
    compare_methods,
    compare_repeatability,
)
from core.errors import NothingUsable
from core.geometry import CAMERA_PARAMETERS
from core.session import (
    ImageObservation,
    SessionData,
    SessionEstimate,
    estimate_session,
    select_images,
)

MAX_NAMED = 5


def comparison_findings(data: SessionData, markers: Markers) -> Findings:
    """Return what `GET .../comparison` answers."""
    selected = select_images(data)
    if selected is None:
        estimate_session(data, weak=True)  # says why nothing can be made of the session
        raise NothingUsable("The session has no image with grid points.")
    session = selected.session(data)
    pooled: SessionEstimate | None = None
    try:
        pooled = estimate_session(session, lens_model="brown", weak=True)  # as every other method here
    except GridposeError as reason:
        failure = Failure(None, reason.code, reason.detail, reason.advice)
    views = [selected.views.view(k) for k in range(len(selected.views))]
    poses: list[str | None] = list(selected.pose_ids)
    unlabelled = 0
    if pooled is not None:
        # Every method takes the points under the labels that the session's images have in common.
        group = pooled.groups[0]
        for row, k in enumerate(group.estimate.images.tolist()):
            views[k] = group.views.view(row)
        for k in set(range(len(views))) - set(group.estimate.images.tolist()):
            if session.images[k].labelling != "absolute":
                poses[k] = None
                unlabelled += 1
    rows = compare_methods(
        views,
        pooled.groups[0].estimate if pooled is not None else failure,
        markers=[markers.get(image.measurement_id) for image in session.images],
        intrinsics=data.intrinsics,
    )
    table = compare_repeatability(rows, poses)
    fields = {
        "focus_group": selected.focus_group,
        "image_count": len(views),
        "calibrations": [
            _calibration(row, session.images, "pooled" if data.intrinsics is None else "session")
            for row in rows
        ],
        "repeatabilities": [_repeatability(row, session.images) for row in table],
    }
    warnings = (*selected.warnings, *_warnings(pooled, unlabelled, len(views)))
    return Findings(fields, selected.excluded, warnings)


def _warnings(pooled: SessionEstimate | None, unlabelled: int, count: int) -> list[Advisory]:
    warnings = list(pooled.warnings) if pooled is not None else []
    if unlabelled:
        warnings.append(
            Advisory(
                "board_symmetry_unresolved",
                f"{unlabelled} images of a board that looks the same when turned have no pooled pose that would "
                "determine how it was turned; they are not in the repeatability of any method.",
                "Use a board whose columns and rows have an odd sum.",
            )
        )
    if count == 1:
        warnings.append(
            Advisory(
                "single_image",
                "The session has one image with grid points: methods that take several views, and repeatability, need "
                "more.",
                "Upload images of several poses, and of each pose several.",
            )
        )
    return warnings


def _calibration(row: MethodRow, images: Sequence[ImageObservation], given: str) -> dict[str, Any]:
    """Return a row of Table II."""
    camera, statistics, answered = row.camera, row.reprojection, len(row.images)
    mean = None if camera is None else dict(zip(CAMERA_PARAMETERS, camera.mean.tolist(), strict=True))
    spread = None if camera is None or camera.spread is None else camera.spread.tolist()
    return {
        "method": row.method,
        "camera_of": given if row.camera_of == "given" else row.camera_of,
        "calibrated": answered,
        "failed": len(images) - answered,
        "reprojection": None
        if statistics is None
        else {name: getattr(statistics, name) for name in _REPROJECTION},
        "intrinsics": mean and {name: mean[name] for name in CAMERA_PARAMETERS[:4]},
        "distortion": mean and {name: mean[name] for name in CAMERA_PARAMETERS[4:]},
        "standard_deviation": spread and dict(zip(CAMERA_PARAMETERS, spread, strict=True)),
        "failures": _failures(row.failures, images),
        "warnings": _method_warnings(row),
        "failure": _failure(row.failure),
    }


_REPROJECTION = ("rms_px", "mean_px", "std_px", "max_px", "points")


def _repeatability(row: MethodRepeatability, images: Sequence[ImageObservation]) -> dict[str, Any]:
    """Return a row of Table III."""
    return {
        "method": row.method,
        "poses": [_pose(pose, images) for pose in row.poses],
        "failure": _failure(row.failure),
    }


def _pose(pose: MethodPose, images: Sequence[ImageObservation]) -> dict[str, Any]:
    return {
        "pose_id": pose.label,
        "cycles": len(pose.images),
        "repeatability": figures_document(pose.repeatability),
        "noise_floor": None if pose.noise_floor is None else figures_document(pose.noise_floor),
        "failures": _failures(pose.failures, images),
        "failure": _failure(pose.failure),
    }


def _failure(failure: Failure | None) -> dict[str, Any] | None:
    if failure is None:
        return None
    return {"code": failure.code, "detail": failure.detail, "advice": failure.advice}


def _failures(failures: Iterable[Failure], images: Sequence[ImageObservation]) -> list[dict[str, Any]]:
    """Return the failures of single images, those of one code together with the first's words."""
    kinds: dict[str, list[tuple[Failure, str]]] = {}
    for failure in failures:
        if failure.image is not None:
            kinds.setdefault(failure.code, []).append((failure, images[failure.image].measurement_id))
    return [
        {
            "code": code,
            "detail": found[0][0].detail,
            "advice": found[0][0].advice,
            "image_count": len(found),
            "measurement_ids": [measurement_id for _, measurement_id in found[:MAX_NAMED]],
        }
        for code, found in kinds.items()
    ]


def _method_warnings(row: MethodRow) -> list[dict[str, Any]]:
    """Return the warnings of a method's results, grouped by code with the detail of the first."""
    kinds: dict[str, tuple[Advisory, int]] = {w.code: (w, len(row.images)) for w in row.warnings}
    for answer in row.answers:
        for warning in answer.result.warnings:
            first, count = kinds.get(warning.code, (warning, 0))
            kinds[warning.code] = (first, count + len(answer.images))
    return [
        {"code": code, "detail": first.detail, "advice": first.advice, "image_count": count}
        for code, (first, count) in kinds.items()
    ]
