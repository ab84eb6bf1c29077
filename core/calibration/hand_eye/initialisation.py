"""Initialisation of hand-eye calibration: check that the motion is sufficient and consistent, then a closed form.

    T_base_flange,i T_flange_camera = T_base_target T_target_camera,i        (AX = ZB)

Rotations first: Σ tr(R_Zᵀ R_B,i R_X R_A,iᵀ) is bilinear in the two rotations' elements, with the matrix K = Σ R_B,i ⊗
R_A,i, so its first pair of singular vectors holds both up to scale (Shah 2013). Then t_X and t_Z by linear least
squares. Both steps believe every pose; where residuals say that some are wrong, the closed form of many small sets of
poses is tried and the one kept whose median residual is least.

References: M. Shah, "Solving the robot-world/hand-eye calibration problem using the Kronecker product", J. Mechanisms
Robotics 5 (2013) 031007, 10.1115/1.4024473; R. Y. Tsai, R. K. Lenz, "A new technique for fully autonomous and efficient
3D robotics hand/eye calibration", IEEE Trans. Robotics and Automation 5 (1989) 345-358, 10.1109/70.34770 (what motion
is needed).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from core.calibration.hand_eye.model import Frames, PoseArrays, residuals
from core.errors import InvalidArgument, MotionInsufficient
from core.geometry import are_rotations, nearest_rotation, rotation_mean, so3_log, transform
from core.numerics import best_subset

MIN_POSES = 3
MIN_ROTATION = math.radians(1.0)
"""A smaller rms rotation about an axis is not counted as motion: robots' own errors are not far below."""
MAX_DISAGREEMENT = math.radians(1.5)
"""Largest median difference of the angles that the robot and the camera say they turned by."""
SUSPICIOUS = 4.0
"""Times the median residual: beyond it a pose may be a wrong one."""
SUBSET, SUBSETS = 4, 150
_ADVICE = "Add poses whose orientations differ by 20° or more about at least two different axes."


def frame_rotations(
    R_base_flange: Float[np.ndarray, "n 3 3"], R_target_camera: Float[np.ndarray, "n 3 3"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]:
    """Return R_flange_camera and R_base_target with R_base_flange R_flange_camera = R_base_target R_target_camera."""
    K = np.einsum("nij,nkl->ikjl", R_base_flange, R_target_camera).reshape(9, 9)
    U, _, Vt = np.linalg.svd(K)
    M_X, M_Z = Vt[0].reshape(3, 3), U[:, 0].reshape(3, 3)
    if np.linalg.det(M_X) < 0:
        M_X, M_Z = -M_X, -M_Z
    return nearest_rotation(M_X), nearest_rotation(M_Z)


def closed_form(
    T_base_flange: Float[np.ndarray, "n 4 4"], T_target_camera: Float[np.ndarray, "n 4 4"]
) -> Frames:
    """Return the frames by Shah's closed form; of poses without motion enough, some that suit them."""
    R_B, R_A = T_base_flange[:, :3, :3], T_target_camera[:, :3, :3]
    R_X, R_Z = frame_rotations(R_B, R_A)
    A = np.concatenate([R_B, np.broadcast_to(-np.eye(3), R_B.shape)], axis=2).reshape(-1, 6)
    b = (T_target_camera[:, :3, 3] @ R_Z.T - T_base_flange[:, :3, 3]).ravel()
    t = np.linalg.lstsq(A, b, rcond=None)[0]
    return Frames(transform(R_X, t[:3]), transform(R_Z, t[3:])[None])


def start_of(poses: PoseArrays) -> Frames:
    """Return the camera on the flange by the poses before the target with the most, and the targets by the camera.

    Raises MotionInsufficient where these poses do not determine the camera on the flange.
    """
    counts = np.bincount(poses.target)
    main = poses.part(poses.target == int(np.argmax(counts)))
    if len(main.target) < MIN_POSES:
        raise MotionInsufficient(f"No target is seen from {MIN_POSES} poses or more.", _ADVICE)
    check_motion(main.T_base_flange)
    camera = robust_start(replace(main, target=np.zeros_like(main.target)))
    return camera if len(counts) == 1 else place_targets(camera.T_flange_camera, poses)


def place_targets(T_flange_camera: Float[np.ndarray, "4 4"], poses: PoseArrays) -> Frames:
    """Return the frames with each target where most poses before it see it."""
    placed = poses.T_base_flange @ T_flange_camera @ np.linalg.inv(poses.T_target_camera)
    targets = []
    for k in range(int(poses.target.max()) + 1):
        of_target = placed[poses.target == k]
        position = np.median(of_target[:, :3, 3], axis=0)
        targets.append(transform(rotation_mean(of_target[:, :3, :3]), position))
    return Frames(T_flange_camera, np.array(targets))


def robust_start(poses: PoseArrays) -> Frames:
    """Return the closed form of all poses before one target, or, with outliers, of the set whose median residual is
    least.
    """
    B, A = poses.T_base_flange, poses.T_target_camera
    everything = closed_form(B, A)
    lengths = _lengths(everything, poses)
    typical = np.median(lengths, axis=1)
    if len(B) <= SUBSET or np.all(lengths.max(axis=1) <= SUSPICIOUS * typical + 1e-12):
        return everything

    def of_sets(sets: Int[np.ndarray, "s k"]) -> Float[np.ndarray, "s 2 n"]:
        return np.array([_lengths(closed_form(B[chosen], A[chosen]), poses) for chosen in sets])

    chosen = best_subset(of_sets, lengths, size=SUBSET, number=SUBSETS)
    return everything if chosen is None else closed_form(B[chosen], A[chosen])


def _lengths(frames: Frames, poses: PoseArrays) -> Float[np.ndarray, "2 n"]:
    """Return the residual lengths of each pose, in position (mm) and rotation (rad)."""
    return np.linalg.norm(residuals(frames, poses).reshape(-1, 2, 3), axis=2).T


def check_rigid(name: str, transforms: Float[np.ndarray, "n 4 4"]) -> None:
    """Raise InvalidArgument unless all are rigid motions."""
    if not np.all(np.isfinite(transforms)):
        raise InvalidArgument(f"The {name} poses must be finite numbers.")
    if not np.all(are_rotations(transforms[:, :3, :3])):
        raise InvalidArgument(f"The {name} poses must have rotation matrices.")


def check_poses(poses: PoseArrays) -> None:
    """Raise InvalidArgument unless all are rigid motions, and the two sides turned by like angles.

    Whatever the frames, two poses before one target differ by the same angle of rotation for the flange as for the
    camera.
    """
    T_base_flange, T_target_camera = poses.T_base_flange, poses.T_target_camera
    check_rigid("commanded", T_base_flange)
    check_rigid("measured", T_target_camera)
    first, second = np.triu_indices(len(T_base_flange), 1)
    of_one = poses.target[first] == poses.target[second]
    first, second = first[of_one], second[of_one]
    if not len(first):
        return
    if len(first) > 2000:
        chosen = np.random.default_rng(0).permutation(len(first))[:2000]
        first, second = first[chosen], second[chosen]
    flange, camera = (_angles(T[first, :3, :3], T[second, :3, :3]) for T in (T_base_flange, T_target_camera))
    disagreement = float(np.median(np.abs(flange - camera)))
    if disagreement > MAX_DISAGREEMENT:
        raise InvalidArgument(
            "Robot and camera contradict each other: between two poses the commanded rotation and the measured "
            f"one differ by {math.degrees(disagreement):.1f}° (median), where a camera on the flange rotates with it.",
            "Check the order and units of roll, pitch, yaw (R = Rz Ry Rx, degrees at the API), that images carry the "
            "right pose_id, and that the target's origin is the same in all images.",
        )


def check_count(count: int) -> None:
    """Raise MotionInsufficient for fewer poses than determine the frames."""
    if count < MIN_POSES:
        raise MotionInsufficient(
            f"Tying the frames needs at least {MIN_POSES} poses, got {count}.",
            "Add poses; ten or more, turned by 20° and more about different axes, are a good number.",
        )


def check_motion(T_base_flange: Float[np.ndarray, "n 4 4"]) -> None:
    """Raise MotionInsufficient where the commanded rotations do not determine the frames; the detail names the part."""
    mean = rotation_mean(T_base_flange[:, :3, :3])
    turns = np.array([so3_log(mean.T @ R) for R in T_base_flange[:, :3, :3]])
    _, singular, Vt = np.linalg.svd(turns, full_matrices=False)
    extent = singular / math.sqrt(len(turns))
    if extent[0] < MIN_ROTATION:
        raise MotionInsufficient(
            "All commanded orientations are the same or nearly so: the position of T_flange_camera is not determined "
            "in any direction, nor that of T_base_target by itself.",
            _ADVICE,
        )
    if extent[1] < MIN_ROTATION:
        axis = ", ".join(f"{value:.2f}" for value in Vt[0] * np.sign(Vt[0][np.argmax(np.abs(Vt[0]))]))
        raise MotionInsufficient(
            f"All commanded rotations are about one axis, ({axis}) of the flange: the position of T_flange_camera "
            "along it is not determined, nor that of T_base_target, and the rotations of both about it only by the "
            "positions.",
            _ADVICE,
        )


def _angles(R: Float[np.ndarray, "k 3 3"], S: Float[np.ndarray, "k 3 3"]) -> Float[np.ndarray, " k"]:
    """Return the angles of Rᵀ S, by ‖R - S‖² = 8 sin²(angle / 2)."""
    chord = np.sqrt(np.sum((R - S) ** 2, axis=(1, 2)) / 8.0)
    return 2.0 * np.arcsin(np.minimum(chord, 1.0))
