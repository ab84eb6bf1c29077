"""Transforms between targets, before any chain is known.

From poses: each pair of poses of two targets gives T_first_target = T_first_camera T_target_camera⁻¹. A pair from one
image that shows both targets has the noise of that image alone. A pair from two images at the same joint angles has the
robot's scatter twice, since the robot moved there twice.

From arcs: a joint that was swept on both targets, with the joints before it at the same angles, has one axis, known in
both frames. Two such axes that are not parallel determine the transform: the rotation from directions (Wahba's problem,
by SVD), then the translation from points, each of which has to lie on its line.

Where poses and arcs both determine the transform, each is weighted by its covariance.

References: G. Wahba, SIAM Review 7 (1965) 409; S. Umeyama, IEEE PAMI 13 (1991) 376-380, 10.1109/34.88573.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.errors import MotionInsufficient
from core.geometry import hat, invert, nearest_rotation, perturbed, so3_log, transform, transform_mean
from core.kinematics.circle_point_analysis.home_configuration import Lines
from core.kinematics.pose_observations import PoseData
from core.numerics import Variances

STEP_MM, STEP_RAD = 1e-4, 1e-7
"""Of differences by lines: far below any axis' uncertainty, far above rounding."""
_SAME = 1e-6  # rad: joint angles that were commanded as the same
_LEAST_SPREAD = 0.1  # second singular value of the directions, for each line: below, they count as parallel
_ADVICE = (
    "Add images that show both targets at once; or sweep two joints whose axes are not parallel on either target, with "
    "the joints before them at the same angles."
)


@dataclass(frozen=True, slots=True)
class TargetLink:
    """T_first_target; `covariance` (6, 6) is of d (mm) and w (rad, from the left) in the first target's frame, without
    what comes from the arcs: `by_arcs` are the derivatives by all arcs' lines, four columns each, None where these had
    no part. `pairs` are what it was found from: poses and axes.
    """

    T_first_target: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    pairs: int
    by_arcs: Float[np.ndarray, "6 q"] | None = None


def link_targets(
    poses: PoseData,
    measured: PoseData,
    scatter: Variances,
    lines: Lines,
    tolerance: float,
) -> dict[int, TargetLink]:
    """Return the transform of every target to the first, by poses and by arcs.

    `poses` are those that the arcs were fitted to, `measured` the same before their joints were set at rest, `scatter`
    what the robot does differently each time.

    Raises MotionInsufficient where a target that arcs were seen on cannot be linked.
    """
    targets = poses.targets
    first = int(targets.min())
    links = {first: TargetLink(np.eye(4), np.zeros((6, 6)), 0)}
    for target in sorted({int(t) for t in targets} - {first}):
        of_poses = _by_poses(poses, measured, scatter, first, target)
        pairs = shared_axes(lines, first, target, tolerance)
        of_arcs = None
        if len(pairs) and (of_poses is None or _determines_transform(lines, pairs)):
            of_arcs = TargetLink(by_arcs(lines, pairs), np.zeros((6, 6)), len(pairs), _by_lines(lines, pairs))
        if of_poses is not None:
            links[target] = of_poses if of_arcs is None else _together(of_poses, of_arcs, lines)
        elif of_arcs is not None:
            links[target] = of_arcs
        elif np.any(lines.targets == target):
            raise MotionInsufficient(
                f"The poses do not determine the transform from target {target + 1} to target {first + 1}.",
                _ADVICE,
            )
    return links


def by_arcs(lines: Lines, pairs: Int[np.ndarray, "p 2"]) -> Float[np.ndarray, "4 4"]:
    """Return T_first_target from axes that were found on both, as `shared_axes` has them.

    Raises MotionInsufficient where these are parallel.
    """
    n, M = lines.directions[pairs[:, 0]], _wahba(lines, pairs)
    if not _determines_transform(lines, pairs):
        raise MotionInsufficient(
            f"All joints that were swept on target {int(lines.targets[pairs[0, 0]]) + 1} and on target "
            f"{int(lines.targets[pairs[0, 1]]) + 1} have parallel axes, which do not determine the transform "
            "between the targets.",
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


def _wahba(lines: Lines, pairs: Int[np.ndarray, "p 2"]) -> Float[np.ndarray, "3 3"]:
    return lines.directions[pairs[:, 0]].T @ lines.directions[pairs[:, 1]]


def _determines_transform(lines: Lines, pairs: Int[np.ndarray, "p 2"]) -> bool:
    """Return whether the axes determine the transform: whether they are not all parallel."""
    singular = np.linalg.svd(_wahba(lines, pairs), compute_uv=False)
    return bool(singular[1] > _LEAST_SPREAD**2 * len(pairs))


def _by_lines(lines: Lines, pairs: Int[np.ndarray, "p 2"]) -> Float[np.ndarray, "6 q"]:
    """Return d(link by arcs) by all lines, by differences."""
    J = np.zeros((6, 4 * len(lines.joints)))
    for arc in np.unique(pairs):
        for k, step in enumerate(np.diag([STEP_MM] * 2 + [STEP_RAD] * 2)):
            ahead, behind = (by_arcs(lines.moved(int(arc), s), pairs) for s in (step, -step))
            J[:, 4 * arc + k] = _from(behind, ahead) / (2.0 * float(step.sum()))
    return J


def _from(T: Float[np.ndarray, "4 4"], other: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "6"]:
    """Return the step (d, w) from one transform to another."""
    return np.array([*(other[:3, 3] - T[:3, 3]), *so3_log(other[:3, :3] @ T[:3, :3].T)])


def _together(of_poses: TargetLink, of_arcs: TargetLink, lines: Lines) -> TargetLink:
    """Return the mean of both links, weighted by the covariance of each, that of the arcs one by one."""
    J = of_arcs.by_arcs
    assert J is not None
    blocks = J.reshape(6, -1, 4).swapaxes(0, 1) @ np.linalg.inv(lines.roots)
    C = np.einsum("aij,akj->ik", blocks, blocks)
    gain = np.linalg.solve((of_poses.covariance + C).T, of_poses.covariance.T).T
    kept = np.eye(6) - gain
    return TargetLink(
        perturbed(of_poses.T_first_target, gain @ _from(of_poses.T_first_target, of_arcs.T_first_target)),
        kept @ of_poses.covariance @ kept.T,
        of_poses.pairs + of_arcs.pairs,
        gain @ J,
    )


def _by_poses(
    poses: PoseData, measured: PoseData, scatter: Variances, first: int, target: int
) -> TargetLink | None:
    if poses.rotations is None:
        return None
    siblings = _of_one_image(poses, first, target)
    visits = _same_angles(poses, first, target, siblings)
    pairs = np.concatenate([siblings, visits])
    if not len(pairs):
        return None
    # An image that shows both needs no angles, and neither of its two poses may be moved without the other.
    seen = (measured,) * len(siblings) + (poses,) * len(visits)
    T_first, T_other = (
        np.array([_pose(of, int(i)) for of, i in zip(seen, column, strict=True)]) for column in pairs.T
    )
    each = np.array([a @ invert(b) for a, b in zip(T_first, T_other, strict=True)])
    T = transform_mean(each)
    R = T[:3, :3]
    own = np.zeros((len(poses), 6, 6)) if poses.covariance is None else poses.covariance
    robot_covariance = np.diag(scatter.diagonal(6))
    information, weighted_step = np.zeros((6, 6)), np.zeros(6)
    effects = []
    for k, ((a, b), T_b) in enumerate(zip(pairs, T_other, strict=True)):
        arm = hat(R @ T_b[:3, 3])
        of_first = np.block([[np.eye(3), arm], [np.zeros((3, 3)), np.eye(3)]])
        of_other = -of_first @ np.kron(np.eye(2), R)
        # Where nothing is known of the instrument, its noise is in the scatter as well.
        extra = robot_covariance if k >= len(siblings) or poses.covariance is None else np.zeros((6, 6))
        C = of_first @ (own[a] + extra) @ of_first.T + of_other @ (own[b] + extra) @ of_other.T
        inverse = np.linalg.inv(C)
        information += inverse
        weighted_step += inverse @ _from(T, each[k])
        if poses.common is not None:
            effects.append(inverse @ (of_first @ poses.common[a] + of_other @ poses.common[b]))
    covariance = np.linalg.inv(information)
    T = perturbed(T, covariance @ weighted_step)
    if effects:
        shared = covariance @ np.sum(effects, axis=0)
        covariance = covariance + shared @ shared.T
    return TargetLink(T, covariance, len(pairs))


def _pose(poses: PoseData, i: int) -> Float[np.ndarray, "4 4"]:
    assert poses.rotations is not None
    return transform(poses.rotations[i], poses.positions_mm[i])


def _of_one_image(poses: PoseData, first: int, target: int) -> Int[np.ndarray, "p 2"]:
    """Return pairs of poses, one of either target, that one image shows."""
    if poses.image is None:
        return np.empty((0, 2), dtype=np.intp)
    here, there = np.flatnonzero(poses.targets == first), np.flatnonzero(poses.targets == target)
    _, a, b = np.intersect1d(poses.image[here], poses.image[there], return_indices=True)
    return np.column_stack([here[a], there[b]])


def _same_angles(
    poses: PoseData, first: int, target: int, siblings: Int[np.ndarray, "s 2"]
) -> Int[np.ndarray, "p 2"]:
    """Return pairs of the other poses, one of either target, with the same joint angles; each in one pair at most."""
    waiting: dict[tuple[int, ...], list[int]] = {}
    keys = np.round(poses.joint_angles / _SAME).astype(np.int64)
    for i in np.setdiff1d(np.flatnonzero(poses.targets == first), siblings):
        waiting.setdefault(tuple(keys[i].tolist()), []).append(int(i))
    pairs = []
    for i in np.setdiff1d(np.flatnonzero(poses.targets == target), siblings):
        same = waiting.get(tuple(keys[i].tolist()))
        if same:
            pairs.append((same.pop(0), int(i)))
    return np.array(pairs, dtype=np.intp).reshape(-1, 2)
