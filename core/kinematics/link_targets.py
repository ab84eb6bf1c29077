"""What targets are to one another, before any chain is known.

By poses: where two targets were measured at the same joint angles (an image that shows both) each pair gives
T_first_target = T_first_camera T_target_camera⁻¹. By arcs: a joint that was swept on either target, the joints before
it resting at the same angles, has one axis, known in both frames; two such axes that are not parallel tell the
transform: the rotation from directions (Wahba's problem, by SVD), then the translation from points, each of which has
to lie on its line.

References: G. Wahba, SIAM Review 7 (1965) 409; S. Umeyama, IEEE PAMI 13 (1991) 376-380, 10.1109/34.88573.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.errors import MotionInsufficient
from core.kinematics.home import Lines
from core.kinematics.poses import PoseData
from core.transforms import hat, invert, nearest_rotation, so3_exp, so3_log, transform, transform_mean

_SAME = 1e-6  # rad: joint angles of one moment
_LEAST_SPREAD = (
    0.1  # second singular value of the directions, for each line: below, they are as good as parallel
)
_ADVICE = (
    "Add images that show both targets at once; or sweep two joints whose axes are not parallel on either target, with "
    "the joints before them at the same angles; or state the transform."
)


@dataclass(frozen=True, slots=True)
class TargetLink:
    """T_first_target; `covariance` (6, 6) is of d (mm) and w (rad, from the left) in the first target's frame, None
    where the arcs tell it and it is still to be carried from theirs. `pairs` are what it was found from: poses or axes.
    """

    T_first_target: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"] | None
    pairs: int


Given = Mapping[int, tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "6 6"]]]
"""Transforms known beforehand, by the target's index, each with its covariance."""


def link_targets(
    poses: PoseData, lines: Lines, given: Given | None, tolerance: float
) -> dict[int, TargetLink]:
    """Return how every target lies to the first: as given, else by poses, else by arcs.

    Raises MotionInsufficient where nothing ties a target that arcs were seen on.
    """
    targets = poses.targets
    first = int(targets.min())
    links = {first: TargetLink(np.eye(4), np.zeros((6, 6)), 0)}
    for target in sorted({int(t) for t in targets} - {first}):
        if given is not None and target in given:
            T, covariance = given[target]
            links[target] = TargetLink(T, covariance, 0)
            continue
        link = _by_poses(poses, first, target)
        if link is None:
            pairs = shared_axes(lines, first, target, tolerance)
            if len(pairs):
                link = TargetLink(by_arcs(lines, pairs), None, len(pairs))
        if link is not None:
            links[target] = link
        elif np.any(lines.targets == target):
            raise MotionInsufficient(
                f"Nothing tells how target {target + 1} lies to target {first + 1}.", _ADVICE
            )
    return links


def by_arcs(lines: Lines, pairs: Int[np.ndarray, "p 2"]) -> Float[np.ndarray, "4 4"]:
    """Return T_first_target from axes that were found on both, as `shared_axes` has them.

    Raises MotionInsufficient where these are parallel.
    """
    n, m = lines.directions[pairs[:, 0]], lines.directions[pairs[:, 1]]
    M = n.T @ m
    singular = np.linalg.svd(M, compute_uv=False)
    if not singular[1] > _LEAST_SPREAD**2 * len(pairs):
        raise MotionInsufficient(
            f"All joints that were swept on target {int(lines.targets[pairs[0, 0]]) + 1} and on target "
            f"{int(lines.targets[pairs[0, 1]]) + 1} have parallel axes: these do not tell how the targets lie to one "
            "another.",
            _ADVICE,
        )
    R = nearest_rotation(M)
    across = np.eye(3) - n[:, :, None] * n[:, None, :]
    between = lines.points[pairs[:, 0]] - lines.points[pairs[:, 1]] @ R.T
    t = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, between))
    return transform(R, t)


def shared_axes(lines: Lines, first: int, target: int, tolerance: float) -> Int[np.ndarray, "p 2"]:
    """Return pairs of arcs of one joint, one on either target, with the joints before it at the same angles."""
    pairs = []
    for a in np.flatnonzero(lines.targets == first):
        for b in np.flatnonzero((lines.targets == target) & (lines.joints == lines.joints[a])):
            before = lines.settings[[a, b], : lines.joints[a]]
            if np.all(np.abs(before[0] - before[1]) <= tolerance):
                pairs.append((a, b))
    return np.array(pairs, dtype=np.intp).reshape(-1, 2)


def _by_poses(poses: PoseData, first: int, target: int) -> TargetLink | None:
    if poses.rotations is None:
        return None
    pairs = _same_moment(poses, first, target)
    if not len(pairs):
        return None
    T_first, T_other = (
        np.array([transform(poses.rotations[i], poses.positions_mm[i]) for i in column]) for column in pairs.T
    )
    each = np.array([a @ invert(b) for a, b in zip(T_first, T_other, strict=True)])
    T = transform_mean(each)
    R = T[:3, :3]
    errors = np.array([[*(t[:3, 3] - T[:3, 3]), *so3_log(t[:3, :3] @ R.T)] for t in each])
    if poses.covariance is None:
        spread = errors.T @ errors / max(len(pairs) - 1, 1)
        return TargetLink(T, spread / len(pairs), len(pairs))
    information, told = np.zeros((6, 6)), np.zeros(6)
    effects = []
    for (a, b), error, T_b in zip(pairs, errors, T_other, strict=True):
        arm = hat(R @ T_b[:3, 3])
        of_first = np.block([[np.eye(3), arm], [np.zeros((3, 3)), np.eye(3)]])
        of_other = -of_first @ np.kron(np.eye(2), R)
        C = of_first @ poses.covariance[a] @ of_first.T + of_other @ poses.covariance[b] @ of_other.T
        inverse = np.linalg.inv(C)
        information += inverse
        told += inverse @ error
        if poses.common is not None:
            effects.append(inverse @ (of_first @ poses.common[a] + of_other @ poses.common[b]))
    covariance = np.linalg.inv(information)
    step = covariance @ told
    T = transform(so3_exp(step[3:]) @ R, T[:3, 3] + step[:3])
    if effects:
        shared = covariance @ np.sum(effects, axis=0)
        covariance = covariance + shared @ shared.T
    return TargetLink(T, covariance, len(pairs))


def _same_moment(poses: PoseData, first: int, target: int) -> Int[np.ndarray, "p 2"]:
    """Return pairs of poses, one of either target, with the same joint angles; each pose in one pair at most."""
    waiting: dict[tuple[int, ...], list[int]] = {}
    keys = np.round(poses.joint_angles / _SAME).astype(np.int64)
    for i in np.flatnonzero(poses.targets == first):
        waiting.setdefault(tuple(keys[i].tolist()), []).append(int(i))
    pairs = []
    for i in np.flatnonzero(poses.targets == target):
        same = waiting.get(tuple(keys[i].tolist()))
        if same:
            pairs.append((same.pop(0), int(i)))
    return np.array(pairs, dtype=np.intp).reshape(-1, 2)
