"""Scatter of repeated poses about their means, with the Jacobian that takes the joints' noise there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from core.errors import MotionInsufficient, TooFewPoses
from core.geometry import rotation_mean, rotation_vectors
from core.kinematics.arm_model import SHORTEST_REACH_MM, THETA, ArmState
from core.kinematics.dh import Chain, forward
from core.kinematics.global_fit import Observations, linearised, observations_of, placed
from core.kinematics.pose_observations import PoseData

MIN_POSES = 4
"""With repeated visits: fewer separate neither joints from one another nor the model from one ellipsoid for all."""
MAX_TOOL_UNCERTAINTY = 0.1
"""Of the chain's length, one standard deviation: what the tool adds to a joint's lever is wrong by as much."""


@dataclass(frozen=True, slots=True)
class PoseScatters:
    """Repeated poses of one arm, in the instrument's frame; m components, 6 or 3 for positions alone.

    Parameters
    ----------
    deviations
        Of every visit from the mean of its pose: mm, then the small rotation times `arm.reach_mm`, mm at the arm's end.
    pose
        Which pose each visit is of.
    jacobian
        Of every pose by its joints' angles, the rotation's rows times `arm.reach_mm`.
    own
        The instrument's mean covariance at each pose, in the same units; zero where none is stated.
    joint_angles
        Mean angles of each pose, rad.
    labels
        The poses' names.
    arm
        The arm that the Jacobian is of: the nominal chain with tool and base from the poses themselves.
    """

    deviations: Float[np.ndarray, "n m"]
    pose: Int[np.ndarray, " n"]
    jacobian: Float[np.ndarray, "k m j"]
    own: Float[np.ndarray, "k m m"]
    joint_angles: Float[np.ndarray, "k j"]
    labels: tuple[str, ...]
    arm: ArmState

    @property
    def visits(self) -> Int[np.ndarray, " k"]:
        """The number of visits to each pose."""
        return np.bincount(self.pose, minlength=len(self.jacobian))

    @property
    def scatter(self) -> Float[np.ndarray, "k m m"]:
        """The sum of the squares of each pose's deviations about their mean."""
        total = np.zeros((len(self.jacobian), *self.own.shape[1:]))
        np.add.at(total, self.pose, self.deviations[:, :, None] * self.deviations[:, None, :])
        return total

    def without(self, dropped: Bool[np.ndarray, " n"]) -> PoseScatters:
        """Return the scatters without these visits, the others taken about their own means."""
        deviations, pose = self.deviations[~dropped], self.pose[~dropped]
        sums = np.zeros((len(self.jacobian), deviations.shape[1]))
        np.add.at(sums, pose, deviations)
        count = np.maximum(np.bincount(pose, minlength=len(self.jacobian)), 1)
        return replace(self, deviations=deviations - (sums / count[:, None])[pose], pose=pose)

    def take(self, poses: Int[np.ndarray, " q"]) -> PoseScatters:
        """Return these poses alone."""
        place = np.full(len(self.jacobian), -1)
        place[poses] = np.arange(len(poses))
        kept = place[self.pose] >= 0
        return replace(
            self,
            deviations=self.deviations[kept],
            pose=place[self.pose[kept]],
            jacobian=self.jacobian[poses],
            own=self.own[poses],
            joint_angles=self.joint_angles[poses],
            labels=tuple(self.labels[i] for i in poses),
        )


def gather_scatters(
    poses: PoseData, nominal: Chain, unchanging: frozenset[str] = frozenset()
) -> PoseScatters:
    """Return the scatter of poses that were visited twice or more; visits of one pose have one label.

    Poses with the labels `unchanging`, whose readings say nothing of a scatter, are not among them. The tool and the
    base of the nominal chain come from all poses in closed form. Raises TooFewPoses where fewer than `MIN_POSES` were
    repeated, MotionInsufficient where the poses do not determine the tool, and as `observations_of` does.
    """
    seen = observations_of(poses)
    T_base_flange = forward(nominal, poses.joint_angles)
    arm = placed(nominal.as_array(), T_base_flange, seen)
    _require_tool(arm, T_base_flange, seen)
    names = [(poses.labels[i], int(seen.target[i])) for i in range(len(seen))]
    counts: dict[tuple[str, int], list[int]] = {}
    for i, name in enumerate(names):
        counts.setdefault(name, []).append(i)
    groups = [
        (label, np.array(visits))
        for (label, _), visits in counts.items()
        if len(visits) > 1 and label not in unchanging
    ]
    if len(groups) < MIN_POSES:
        but = " with readings that change" if unchanging else ""
        raise TooFewPoses(
            f"{len(groups)} poses were visited more than once{but}; {MIN_POSES} are the least that show the joints' "
            "noise.",
            "Visit ten poses or more, spread over the workspace, ten times each or more.",
        )
    reach = arm.reach_mm
    deviations = [_deviations(seen, visits, reach) for _, visits in groups]
    middle = np.array([seen.joint_angles[visits].mean(axis=0) for _, visits in groups])
    unit = np.array([1.0] * 3 + [reach] * 3)[: seen.components]
    return PoseScatters(
        np.concatenate(deviations),
        np.repeat(np.arange(len(groups)), [len(visits) for _, visits in groups]),
        joint_jacobian(arm, middle, np.array([seen.target[v[0]] for _, v in groups]))[:, : seen.components],
        np.array([seen.own[visits].mean(axis=0) for _, visits in groups]) * np.outer(unit, unit),
        middle,
        tuple(label for label, _ in groups),
        arm,
    )


def _require_tool(arm: ArmState, T_base_flange: Float[np.ndarray, "n 4 4"], seen: Observations) -> None:
    """Raise MotionInsufficient where the poses leave the tool's position uncertain, by their misfit to the arm.

    Positions are linear in it and in each target's own (`placed`): its information is Σ (R - R̄)ᵀ(R - R̄), R the
    flange's orientations and R̄ their mean for each target.
    """
    found = arm.T_target_base[seen.target] @ T_base_flange @ arm.T_flange_camera
    variance = float(np.mean((seen.positions_mm - found[:, :3, 3]) ** 2))
    information = np.zeros((3, 3))
    for target in np.unique(seen.target):
        R = T_base_flange[seen.target == target, :3, :3]
        mean = R.mean(axis=0)
        information += len(R) * (np.eye(3) - mean.T @ mean)
    least = float(np.linalg.eigvalsh(information)[0])
    length = max(arm.links_mm, SHORTEST_REACH_MM)
    if variance > max(least, 0.0) * (MAX_TOOL_UNCERTAINTY * length) ** 2:
        raise MotionInsufficient(
            "The orientations of these poses differ too little to determine the tool, the place of the camera or "
            "reflector on the flange; each joint's part of the scatter depends on it.",
        )


def joint_jacobian(
    arm: ArmState, joint_angles: Float[np.ndarray, "k j"], target: Int[np.ndarray, " k"]
) -> Float[np.ndarray, "k 6 j"]:
    """Return the derivatives of the pose by the joints' angles: mm, then the rotation times the arm's reach."""
    count = len(joint_angles)
    at = Observations(
        np.ascontiguousarray(joint_angles),
        np.zeros((count, 3)),
        np.broadcast_to(np.eye(3), (count, 3, 3)),
        np.zeros((count, 6, 6)),
        np.zeros((count, 6, 0)),
        target,
    )
    J = linearised(replace(arm, shared=np.zeros(0)), at)[1]
    columns = [arm.layout.column(joint, THETA) for joint in range(arm.layout.joints)]
    J = J[columns].transpose(2, 1, 0).copy()
    J[:, 3:] *= arm.reach_mm
    return J


def _deviations(seen: Observations, visits: Int[np.ndarray, " v"], reach: float) -> Float[np.ndarray, "v m"]:
    off = seen.positions_mm[visits] - seen.positions_mm[visits].mean(axis=0)
    if seen.rotations is None:
        return off
    rotations = seen.rotations[visits]
    turned = rotation_vectors(rotations, rotation_mean(rotations))
    return np.concatenate([off, reach * (turned - turned.mean(axis=0))], axis=1)
