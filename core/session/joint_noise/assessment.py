"""Joint noise of a session: gathered from its repeated poses, fitted, validated, and predicted over the workspace."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.errors import Advisory, JointAnglesInconsistent, NominalRobotMissing, listed
from core.kinematics import JointNoise, PoseData, PoseScatters, fit_joint_noise, gather_scatters
from core.metrology import are_unchanging
from core.session.estimate import ExcludedMeasurement, SessionEstimate
from core.session.estimation import estimate_session
from core.session.joint_noise.held_out import HeldOutScatter, validate_joint_noise
from core.session.joint_noise.prediction import PredictedScatter, predict_scatter
from core.session.joint_noise.workspace import RepeatabilityMap, map_repeatability
from core.session.model import SessionData
from core.session.repeatability import burst_noise, burst_warnings, with_burst_noise
from core.session.robot import (
    RobotPoses,
    gather_robot_poses,
    with_nominal_orientations,
    workspace_limits,
)

MIN_HELD_OUT_CHI, MAX_HELD_OUT_CHI = 0.8, 1.25
"""Between them, predicted covariances have the size of the scatter at held-out poses."""


@dataclass(frozen=True, slots=True)
class PosePrediction:
    """A measured pose: its visits that count, and RP_l held out of the fit, measured over predicted; None where none
    count.
    """

    pose_id: str
    visits: int
    rp_ratio: float | None


@dataclass(frozen=True, slots=True)
class SessionJointNoise:
    """Joint noise of a session's robot.

    `poses` are those that were repeated, `at_poses` what is predicted there and `at_angles` at the joint angles asked
    for, in their order. `outliers` are visits that the fit excluded. `limits_stated` says of every joint whether the
    workspace ends at its stated limits, or at where the poses were.
    """

    noise: JointNoise
    scatters: PoseScatters
    held_out: HeldOutScatter
    poses: tuple[PosePrediction, ...]
    at_poses: PredictedScatter
    at_angles: PredictedScatter | None
    map: RepeatabilityMap
    limits_stated: tuple[bool, ...]
    excluded: tuple[ExcludedMeasurement, ...]
    warnings: tuple[Advisory, ...]


def assess_joint_noise(
    data: SessionData,
    estimate: SessionEstimate | None = None,
    *,
    limits: Float[np.ndarray, "2 j"],
    at: Sequence[Sequence[float]] = (),
) -> SessionJointNoise:
    """Fit the noise of the joints to the scatter of the session's repeated poses, and predict RP_l by it.

    Parameters
    ----------
    limits
        The robot's, degrees, of its stated joint angles; infinite where it has none: there the workspace ends where the
        poses were.
    at
        Joint angles to predict at, degrees, as the robot states them.

    Raises NominalRobotMissing without a robot, JointAnglesInconsistent for angles of another number of joints,
    TooFewPoses, and as `poses_of_readings` and `poses_of_estimate` do.
    """
    if data.nominal is None:
        raise NominalRobotMissing(
            "The joints' noise needs the robot's geometry, and the session names no robot."
        )
    if estimate is None and data.images and not data.measured:
        estimate = estimate_session(with_nominal_orientations(data))
    gathered = gather_robot_poses(data, estimate, nominal_prints=True)
    poses, of_bursts = _with_burst_noise(gathered)
    unchanging = _unchanging(poses)
    seen = gather_scatters(poses, data.nominal, unchanging)
    noise = fit_joint_noise(seen)
    held_out = validate_joint_noise(seen, noise)
    angles = _stated(data, at)
    model_limits, stated = workspace_limits(data, limits, seen.joint_angles)
    visits = seen.without(noise.outliers).visits.tolist()
    return SessionJointNoise(
        noise,
        seen,
        held_out,
        tuple(
            PosePrediction(label, count, ratio if math.isfinite(ratio) else None)
            for label, count, ratio in zip(seen.labels, visits, held_out.rp_ratio.tolist(), strict=True)
        ),
        predict_scatter(noise, seen.arm, seen.joint_angles),
        predict_scatter(noise, seen.arm, angles) if len(angles) else None,
        map_repeatability(noise, seen.arm, model_limits),
        stated,
        gathered.excluded,
        (
            *gathered.warnings,
            *of_bursts,
            *_unchanging_warning(unchanging),
            *_warnings(noise, seen, held_out),
        ),
    )


def _with_burst_noise(gathered: RobotPoses) -> tuple[PoseData, list[Advisory]]:
    """Return the poses with what images scatter within their stops beyond the model in their covariances, since that is
    no joint's, and the warning that says so.

    It is that of all poses before a target together: few stops of one pose determine it too roughly for the fit, which
    takes the instrument's covariances as known.
    """
    poses, places = gathered.poses, dict[str, list[int]]()
    for i, stop in enumerate(gathered.stops):
        places.setdefault(str(stop.frame), []).append(i)
    stops = {target: [gathered.stops[i] for i in rows] for target, rows in places.items()}
    found = burst_noise(stops)
    if found is None or not any(found.above_model) or poses.covariance is None:
        return poses, []
    covariance = poses.covariance.copy()
    for target, wider in with_burst_noise(stops, found).items():
        for i, stop in zip(places[target], wider, strict=True):
            modelled = gathered.stops[i].scatter
            if stop.scatter is not None and modelled is not None:
                covariance[i] += stop.scatter - modelled
    return replace(poses, covariance=covariance), burst_warnings(found)


def _unchanging(poses: PoseData) -> frozenset[str]:
    """Return the labels of poses of which all visits read one position."""
    visits: dict[tuple[str, int], list[int]] = {}
    for i, name in enumerate(zip(poses.labels, poses.targets.tolist(), strict=True)):
        visits.setdefault(name, []).append(i)
    return frozenset(label for (label, _), rows in visits.items() if are_unchanging(poses.positions_mm[rows]))


def _unchanging_warning(labels: frozenset[str]) -> list[Advisory]:
    if not labels:
        return []
    return [
        Advisory(
            "no_scatter",
            f"All visits of {listed(sorted(labels))} read one position to the last digit: they say nothing of the "
            "joints' noise, and are not counted.",
            "Check that each visit was measured anew: no frozen stream, nor the commanded pose read back.",
        )
    ]


def _stated(data: SessionData, at: Sequence[Sequence[float]]) -> Float[np.ndarray, "n j"]:
    assert data.nominal is not None
    joints = len(data.nominal)
    if any(len(angles) != joints for angles in at):
        raise JointAnglesInconsistent(
            f"Angles to predict at have another number than the robot's {joints} joints.",
            "Give one angle for each joint, degrees, from the base.",
        )
    return data.model_angles(np.array(at, dtype=np.float64).reshape(-1, joints))


def _whole_poses(noise: JointNoise, seen: PoseScatters) -> str:
    """Return words for the poses of which no visit counts: of two that disagree, either may be wrong."""
    lost = np.flatnonzero(seen.without(noise.outliers).visits == 0)
    return f", all of {listed([seen.labels[pose] for pose in lost])}" if len(lost) else ""


def _warnings(noise: JointNoise, seen: PoseScatters, held_out: HeldOutScatter) -> list[Advisory]:
    found = []
    if not held_out.supported:
        found.append(
            Advisory(
                "joint_noise_not_supported",
                "At held-out poses the joints' noise does not predict the scatter better than one covariance for all "
                "poses does, by more than chance.",
                "Measure ten poses or more, far apart in joint space, ten times each or more.",
            )
        )
    if not MIN_HELD_OUT_CHI <= held_out.chi_ratio <= MAX_HELD_OUT_CHI:
        found.append(
            Advisory(
                "joint_noise_size_off",
                f"At held-out poses the scatter is {held_out.chi_ratio:.2f} times what is predicted.",
                "Look at the poses' own rp_ratio: drift, play or a loose mount is no noise of joints.",
            )
        )
    unseen = [str(joint + 1) for joint in np.flatnonzero(~noise.identifiable)]
    if unseen:
        found.append(
            Advisory(
                "joint_noise_not_observable",
                f"Joint{'s' if len(unseen) > 1 else ''} {', '.join(unseen)} move the measured point by nothing at "
                "these poses: nothing is said of their noise, and none is predicted.",
                "Measure orientation too, or a point further from the axis.",
            )
        )
    dropped = int(noise.outliers.sum())
    if dropped:
        found.append(
            Advisory(
                "joint_noise_outliers",
                f"{dropped} of {len(seen.deviations)} visits are further from their mean than the joints' noise "
                f"explains, and were excluded{_whole_poses(noise, seen)}.",
                "Look at these cycles in the assessment of repeatability: their images, outliers and drift.",
            )
        )
    return found
