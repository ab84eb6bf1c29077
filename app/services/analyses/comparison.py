"""Every method on the same images, as the paper compares them: its Tables II (calibration) and III (repeatability)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from app.records.codec import decode_markers, decode_points
from app.services.analyses.comparison_images import Chosen, choose_images
from app.services.analyses.documents import advisories
from app.services.analyses.estimation import SessionEstimate, estimate_session
from app.services.analyses.naming import origin_of
from app.services.analyses.outcome import CannotAnalyse
from app.services.analyses.snapshot import Image, Snapshot
from core import Advisory, Camera, Lens, TargetSpec
from core.calibration.baselines import Failure, MethodRow, compare_methods
from core.calibration.estimators import GroupEstimate
from core.camera import CAMERA_PARAMETERS
from core.metrology import Figures
from core.metrology.methods import MethodPose, MethodRepeatability, compare_repeatability
from core.transforms import compose, invert, transform

NAMES = ("position_mm", "x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg")
NAMED = 5


@dataclass(frozen=True, slots=True)
class _Pooled:
    """The pooled estimate of the images compared, or why there is none; and how boards that look the same when turned
    were read: T_target_turned by image, None for an image of such a board that the estimate does not have.
    """

    session: SessionEstimate | None
    estimate: GroupEstimate | Failure
    turns: tuple[Float[np.ndarray, "4 4"] | None, ...]


def comparison_document(
    snapshot: Snapshot, points: Mapping[str, bytes], settings: Mapping[str, str]
) -> dict[str, Any]:
    """Return what `GET .../comparison` answers, but for the fields every analysis has."""
    chosen = choose_images(snapshot, points)
    if not chosen.images:
        estimate_session(snapshot, points, "pooled")  # says why nothing can be made of the session
        raise CannotAnalyse("nothing_usable", "The session has no image with grid points.", None)
    targets = [TargetSpec(**target) for target in snapshot.targets]
    views = [
        decode_points(points[i.measurement_id], [], targets[i.target], i.width_px, i.height_px)
        for i in chosen.images
    ]
    pooled = _pool(replace(snapshot, images=chosen.images), points, targets)
    markers = [snapshot.markers.get(image.measurement_id) for image in chosen.images]
    rows = compare_methods(
        views,
        markers=[decode_markers(seen) if seen is not None else None for seen in markers],
        intrinsics=Camera(**snapshot.intrinsics) if snapshot.intrinsics is not None else None,
        lens=Lens(**snapshot.lens) if snapshot.lens is not None else None,
        pooled=pooled.estimate,
    )
    poses = [
        pose if turn is not None else None for pose, turn in zip(chosen.poses, pooled.turns, strict=True)
    ]
    turns = [np.eye(4) if turn is None else turn for turn in pooled.turns]
    given = "pooled" if snapshot.intrinsics is None else "session"
    return {
        "focus_group": chosen.focus_group,
        "images": len(views),
        "calibration": [_calibration(row, chosen.images, given) for row in rows],
        "repeatability": [
            _repeatability(row, chosen.images) for row in compare_repeatability(rows, poses, turns)
        ],
        "warnings": advisories((*chosen.warnings, *_remarks(pooled, chosen))),
    }


def _pool(snapshot: Snapshot, points: Mapping[str, bytes], targets: Sequence[TargetSpec]) -> _Pooled:
    """Estimate as `repeatability` does, with the readings of alike boards that it takes."""
    try:
        session = estimate_session(snapshot, points, "pooled")
    except CannotAnalyse as reason:
        refused = reason.refused
        failure = Failure(None, refused.code, refused.detail, refused.advice)
        return _Pooled(None, failure, (np.eye(4),) * len(snapshot.images))
    (group,) = session.groups
    turns: list[Float[np.ndarray, "4 4"] | None] = [
        np.eye(4) if origin_of(image, targets[image.target]) == "known" else None for image in snapshot.images
    ]
    estimate = group.estimate
    for k, i in enumerate(estimate.images.tolist()):
        read = group.images[k]
        unturned = transform(estimate.rotations[k], estimate.positions_mm[k])
        if np.array_equal(read.rotation, unturned[:3, :3]):
            turns[i] = np.eye(4)
        else:
            turns[i] = compose(unturned, invert(transform(read.rotation, read.position_mm)))
    return _Pooled(session, estimate, tuple(turns))


def _remarks(pooled: _Pooled, chosen: Chosen) -> list[Advisory]:
    remarks = list(pooled.session.warnings) if pooled.session is not None else []
    unread = sum(turn is None for turn in pooled.turns)
    if unread:
        remarks.append(
            Advisory(
                "reading_unknown",
                f"{unread} images of a board that looks the same when turned have no pooled pose to tell which way it "
                "was; they are not in the repeatability of any method.",
                "Use a board whose columns and rows have an odd sum.",
            )
        )
    if len(chosen.images) == 1:
        remarks.append(
            Advisory(
                "one_image",
                "The session has one image with grid points: methods that take several views, and repeatability, need "
                "more.",
                "Upload images of several poses, and of each pose several.",
            )
        )
    return remarks


def _calibration(row: MethodRow, images: Sequence[Image], given: str) -> dict[str, Any]:
    """Return a row of Table II."""
    camera, statistics, answered = row.camera, row.reprojection, len(row.images)
    mean = None if camera is None else dict(zip(CAMERA_PARAMETERS, camera.mean.tolist(), strict=True))
    spread = None if camera is None or camera.spread is None else camera.spread.tolist()
    return {
        "method": row.method,
        "camera": given if row.camera_of == "given" else row.camera_of,
        "calibrated": answered,
        "failed": len(images) - answered,
        "reprojection": None
        if statistics is None
        else {name: getattr(statistics, name) for name in _REPROJECTION},
        "intrinsics": mean and {name: mean[name] for name in CAMERA_PARAMETERS[:4]},
        "distortion": mean and {name: mean[name] for name in CAMERA_PARAMETERS[4:]},
        "spread": spread and dict(zip(CAMERA_PARAMETERS, spread, strict=True)),
        "failures": _failures(row.failures, images),
        "remarks": _method_remarks(row),
        "failure": _failure(row.failure),
    }


_REPROJECTION = ("rms_px", "mean_px", "std_px", "max_px", "points")


def _repeatability(row: MethodRepeatability, images: Sequence[Image]) -> dict[str, Any]:
    """Return a row of Table III."""
    return {
        "method": row.method,
        "poses": [_pose(pose, images) for pose in row.poses],
        "failure": _failure(row.failure),
    }


def _pose(pose: MethodPose, images: Sequence[Image]) -> dict[str, Any]:
    return {
        "pose_id": pose.label,
        "n": len(pose.images),
        "repeatability": _figures(pose.repeatability),
        "noise_floor": None if pose.noise_floor is None else _figures(pose.noise_floor),
        "failures": _failures(pose.failures, images),
        "failure": _failure(pose.failure),
    }


def _figures(figures: Figures[float | None]) -> dict[str, float | None]:
    """Return figures under the API's names, angles in degrees."""
    factors = (1.0, 1.0, 1.0, 1.0, *[math.degrees(1.0)] * 3)
    return {
        name: None if value is None else factor * value
        for name, factor, (_, value) in zip(NAMES, factors, figures.items(), strict=True)
    }


def _failure(failure: Failure | None) -> dict[str, Any] | None:
    if failure is None:
        return None
    return {"code": failure.code, "detail": failure.detail, "advice": failure.advice}


def _failures(failures: Iterable[Failure], images: Sequence[Image]) -> list[dict[str, Any]]:
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
            "images": len(found),
            "measurement_ids": [measurement_id for _, measurement_id in found[:NAMED]],
        }
        for code, found in kinds.items()
    ]


def _method_remarks(row: MethodRow) -> list[dict[str, Any]]:
    """Return what the method says of its answers, remarks of one code together with the first's words."""
    kinds: dict[str, tuple[Advisory, int]] = {r.code: (r, len(row.images)) for r in row.remarks}
    for answer in row.answers:
        for remark in answer.result.warnings:
            first, count = kinds.get(remark.code, (remark, 0))
            kinds[remark.code] = (first, count + len(answer.images))
    return [
        {"code": code, "detail": first.detail, "advice": first.advice, "images": count}
        for code, (first, count) in kinds.items()
    ]
