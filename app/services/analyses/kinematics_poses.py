"""What a robot's kinematics are identified from: a session's poses with their joint angles, of images or readings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from app.services.analyses.estimation import EstimatedImage, SessionEstimate, estimate_session
from app.services.analyses.measured import MeasuredVisit, measured_visits, semidefinite
from app.services.analyses.outcome import CannotAnalyse
from app.services.analyses.snapshot import Commanded, Snapshot
from core import Advisory
from core.kinematics.dh import Chain, JointParameters, forward
from core.kinematics.poses import PoseData, stack_joint_angles
from core.transforms import rotation_to_rpy

POSES_AT_MOST = 20_000
"""Of one identification, which takes some 20 kB for each."""
NAMED = 5
LENS_FACTORS = 8
"""The columns of an image's `common` that are its lens's; the last is the print's scale."""


@dataclass(frozen=True, slots=True)
class RobotPoses:
    """Poses ready for identification.

    `targets` are the places, in the session's list, of the targets that `poses.target` counts; empty for another
    instrument. `estimate` and `images`, one a pose, where the poses come from images.
    """

    poses: PoseData
    targets: tuple[int, ...]
    warnings: tuple[Advisory, ...]
    estimate: SessionEstimate | None = None
    images: tuple[EstimatedImage, ...] = ()


def nominal_chain(robot: Sequence[Mapping[str, float]] | None) -> Chain | None:
    """Return the robot as it was described to the service."""
    if robot is None:
        return None
    return Chain(
        tuple(
            JointParameters(
                joint["a_mm"],
                math.radians(joint["alpha_deg"]),
                joint["d_mm"],
                math.radians(joint["theta_offset_deg"]),
            )
            for joint in robot
        )
    )


def gather_poses(
    snapshot: Snapshot, points: Mapping[str, bytes], settings: Mapping[str, str], nominal: Chain | None
) -> RobotPoses:
    """Return the session's poses that carry joint angles.

    Raises CannotAnalyse where there are none or too many, JointAnglesInconsistent where their joints are not the
    robot's.
    """
    count = len(snapshot.measured) + len(snapshot.images)
    if count > POSES_AT_MOST:
        raise CannotAnalyse(
            "too_many_measurements",
            f"The session holds {count} measurements; one identification takes {POSES_AT_MOST}.",
            "Divide them among several sessions; a few hundred poses that move all joints say nearly as much.",
        )
    if settings["source"] == "measured_poses":
        return _of_readings(snapshot, nominal)
    return _of_images(snapshot, points, settings["estimator"], nominal)


def _of_images(
    snapshot: Snapshot, points: Mapping[str, bytes], estimator: str, nominal: Chain | None
) -> RobotPoses:
    estimate = estimate_session(_with_orientations(snapshot, nominal), points, estimator)
    angles = [_angles(e, snapshot.commanded.get(e.image.pose_id)) for e in estimate.images]
    unclear = [e.measurement_id in estimate.unclear for e in estimate.images]
    keep = [i for i, values in enumerate(angles) if values is not None and not unclear[i]]
    if not keep:
        raise CannotAnalyse(
            "joint_angles_missing",
            f"None of the {len(estimate.images)} images that serve carries joint angles, nor does its pose.",
            "Send joint_angles_deg with the poses (POST .../poses) or with the images.",
        )
    images = tuple(estimate.images[i] for i in keep)
    labels = tuple(e.image.pose_id for e in images)
    q = np.radians(stack_joint_angles([angles[i] for i in keep], len(nominal) if nominal else None, labels))
    targets = tuple(sorted({e.image.target for e in images}))
    poses = PoseData(
        q,
        np.array([e.position_mm for e in images]),
        np.array([e.rotation for e in images]),
        np.array([_own_covariance(e) for e in images]),
        _common(images),
        np.array([targets.index(e.image.target) for e in images], dtype=np.intp),
        labels,
        images_shown(images),
    )
    without = sorted({e.image.pose_id for i, e in enumerate(estimate.images) if angles[i] is None})
    return RobotPoses(
        poses, targets, (*estimate.warnings, *_left_out(without, "joint_angles_missing")), estimate, images
    )


def images_shown(images: Sequence[EstimatedImage]) -> Int[np.ndarray, " n"]:
    """Return which image each estimate is of: several targets in one image are as many estimates."""
    shots = [(e.image.pose_id, e.image.cycle, e.image.sha256) for e in images]
    place = {shot: i for i, shot in enumerate(dict.fromkeys(shots))}
    return np.array([place[shot] for shot in shots], dtype=np.intp)


def _angles(e: EstimatedImage, commanded: Commanded | None) -> list[float] | None:
    """Return an image's own joint angles, or else its pose's."""
    if e.image.joint_angles_deg is not None:
        return e.image.joint_angles_deg
    return commanded.joint_angles_deg if commanded is not None else None


def _own_covariance(e: EstimatedImage) -> Float[np.ndarray, "6 6"]:
    """Return what an image's pose does not share with others': all of its covariance but the common part."""
    return semidefinite(e.covariance - e.common @ e.common.T)


def _common(images: Sequence[EstimatedImage]) -> Float[np.ndarray, "n 6 k"] | None:
    """Return the factors of common errors: one lens for each focus group, one scale for each target's print."""
    groups = sorted({e.image.focus_group for e in images})
    targets = sorted({e.image.target for e in images})
    common = np.zeros((len(images), 6, LENS_FACTORS * len(groups) + len(targets)))
    for i, e in enumerate(images):
        first = LENS_FACTORS * groups.index(e.image.focus_group)
        common[i, :, first : first + LENS_FACTORS] = e.common[:, :LENS_FACTORS]
        common[i, :, LENS_FACTORS * len(groups) + targets.index(e.image.target)] = e.common[:, LENS_FACTORS]
    told = np.any(common != 0.0, axis=(0, 1))
    return np.ascontiguousarray(common[:, :, told]) if told.any() else None


def _with_orientations(snapshot: Snapshot, nominal: Chain | None) -> Snapshot:
    """Return the snapshot with the nominal robot's orientations for poses that were commanded by joint angles alone.

    They decide how a board was read that looks the same when turned; how the flange is turned to the camera does not
    matter there.
    """
    if nominal is None:
        return snapshot
    by_joints = {
        pose_id: c
        for pose_id, c in snapshot.commanded.items()
        if c.roll_deg is None and c.joint_angles_deg is not None and len(c.joint_angles_deg) == len(nominal)
    }
    if not by_joints:
        return snapshot
    q = np.radians(np.array([c.joint_angles_deg for c in by_joints.values()], dtype=np.float64))
    commanded = dict(snapshot.commanded)
    for (pose_id, c), T in zip(by_joints.items(), forward(nominal, q), strict=True):
        roll, pitch, yaw = np.degrees(rotation_to_rpy(T[:3, :3])).tolist()
        commanded[pose_id] = replace(c, roll_deg=roll, pitch_deg=pitch, yaw_deg=yaw)
    return replace(snapshot, commanded=commanded)


def _of_readings(snapshot: Snapshot, nominal: Chain | None) -> RobotPoses:
    visits = measured_visits(snapshot)
    warnings: list[Advisory] = []
    angles = {v.measurement_id: _visit_angles(v, snapshot.commanded.get(v.pose_id)) for v in visits}
    known = [v for v in visits if angles[v.measurement_id] is not None]
    if not known:
        raise CannotAnalyse(
            "joint_angles_missing",
            f"None of the {len(visits)} measured poses carries joint angles.",
            "Send joint_angles_deg with the measured poses, or with the poses of the same pose_id.",
        )
    without = sorted({v.pose_id for v in visits} - {v.pose_id for v in known})
    warnings += _left_out(without, "joint_angles_missing")
    turned = [v for v in known if v.rotation is not None]
    if turned and 2 * len(turned) >= len(known):
        warnings += _left_out(
            [v.pose_id for v in known if v.rotation is None],
            "rotations_missing",
            "have no rotation, while most have one",
        )
        known = turned
    elif turned:
        warnings.append(
            Advisory(
                "rotations_left_out",
                f"{len(turned)} of {len(known)} measured poses have a rotation; positions alone are used.",
                "Measure rotations at most poses, or identify from those that have one in a session of their own.",
            )
        )
        known = [replace(v, rotation=None) for v in known]
    rotations = [v.rotation for v in known if v.rotation is not None]
    covariances = [v.covariance for v in known if v.covariance is not None]
    if 0 < len(covariances) < len(known):
        warnings.append(
            Advisory(
                "covariances_left_out",
                f"{len(covariances)} of {len(known)} measured poses state a covariance; none is used, and the noise "
                "is read from the residuals.",
                "State the instrument's covariance with each reading, or with none.",
            )
        )
    labels = tuple(v.pose_id for v in known)
    poses = PoseData(
        np.radians(
            stack_joint_angles(
                [angles[v.measurement_id] for v in known], len(nominal) if nominal else None, labels
            )
        ),
        np.array([v.position_mm for v in known]),
        np.array(rotations) if len(rotations) == len(known) else None,
        np.array(covariances) if len(covariances) == len(known) else None,
        labels=labels,
    )
    return RobotPoses(poses, (), tuple(warnings))


def _visit_angles(visit: MeasuredVisit, commanded: Commanded | None) -> list[float] | None:
    if visit.joint_angles_deg is not None:
        return visit.joint_angles_deg
    return commanded.joint_angles_deg if commanded is not None else None


def _left_out(pose_ids: Sequence[str], code: str, what: str = "have no joint angles") -> list[Advisory]:
    if not pose_ids:
        return []
    more = f" and {len(pose_ids) - NAMED} more" if len(pose_ids) > NAMED else ""
    return [
        Advisory(
            code,
            f"Poses {', '.join(pose_ids[:NAMED])}{more} {what} and are left out.",
            "Send what is missing, and the poses count.",
        )
    ]
