"""Where hand-eye calibration starts: is there motion enough, do both sides tell of the same motion, and a closed form.

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

import numpy as np
from jaxtyping import Float, Int

from core.calibration.hand_eye.model import Frames, PoseArrays, residuals
from core.errors import InvalidArgument, MotionInsufficient
from core.transforms import nearest_rotation, rotation_mean, so3_log, transform

LEAST_POSES = 3
LEAST_ROTATION = math.radians(1.0)
"""A smaller rms rotation about an axis is none: robots' own errors are not far below."""
LARGEST_DISAGREEMENT = math.radians(1.5)
"""Largest median difference of the angles that the robot and the camera say they turned by."""
SUSPICIOUS = 4.0
"""Times the median residual: beyond it a pose may be a wrong one."""
SUBSET, SUBSETS = 4, 150
_ADVICE = (
    "Add poses whose orientations differ by 20° or more about at least two different axes; or tie the frames by the "
    "commanded positions alone, which tells position accuracy; or state where the camera is mounted."
)


def closed_form(
    T_base_flange: Float[np.ndarray, "n 4 4"], T_target_camera: Float[np.ndarray, "n 4 4"]
) -> Frames:
    """Return the frames by Shah's closed form; of poses without motion enough, some that suit them."""
    R_B, R_A = T_base_flange[:, :3, :3], T_target_camera[:, :3, :3]
    K = np.einsum("nij,nkl->ikjl", R_B, R_A).reshape(9, 9)
    U, _, Vt = np.linalg.svd(K)
    M_X, M_Z = Vt[0].reshape(3, 3), U[:, 0].reshape(3, 3)
    if np.linalg.det(M_X) < 0:
        M_X, M_Z = -M_X, -M_Z
    R_X, R_Z = nearest_rotation(M_X), nearest_rotation(M_Z)
    A = np.concatenate([R_B, np.broadcast_to(-np.eye(3), R_B.shape)], axis=2).reshape(-1, 6)
    b = (T_target_camera[:, :3, 3] @ R_Z.T - T_base_flange[:, :3, 3]).ravel()
    t = np.linalg.lstsq(A, b, rcond=None)[0]
    return Frames(transform(R_X, t[:3]), transform(R_Z, t[3:]))


def robust_start(poses: PoseArrays) -> Frames:
    """Return the closed form of all poses, or of the set whose median residual is least where some look wrong."""
    B, A = poses.T_base_flange, poses.T_target_camera
    everything = closed_form(B, A)
    lengths = _lengths(everything, poses)
    typical = np.median(lengths, axis=1)
    if len(B) <= SUBSET or np.all(lengths.max(axis=1) <= SUSPICIOUS * typical + 1e-12):
        return everything
    best, least = everything, 2.0
    for chosen in _subsets(len(B)):
        candidate = closed_form(B[chosen], A[chosen])
        medians = np.median(_lengths(candidate, poses), axis=1)
        score = float(np.sum(medians / np.maximum(typical, 1e-12)))
        if score < least:
            best, least = candidate, score
    return best


def _lengths(frames: Frames, poses: PoseArrays) -> Float[np.ndarray, "2 n"]:
    """Return how far each pose is off, in position (mm) and rotation (rad)."""
    return np.linalg.norm(residuals(frames, poses).reshape(-1, 2, 3), axis=2).T


def _subsets(count: int) -> Int[np.ndarray, "s k"]:
    """Return sets of poses to try, the same ones every time."""
    rng = np.random.default_rng(0)
    return np.array([rng.permutation(count)[:SUBSET] for _ in range(SUBSETS)])


def check_rigid(name: str, transforms: Float[np.ndarray, "n 4 4"]) -> None:
    """Raise InvalidArgument unless all are rigid motions."""
    if not np.all(np.isfinite(transforms)):
        raise InvalidArgument(f"The {name} poses must be finite numbers.")
    R = transforms[:, :3, :3]
    orthonormal = np.abs(R @ R.swapaxes(1, 2) - np.eye(3)).max(initial=0.0) < 1e-6
    if not orthonormal or np.any(np.linalg.det(R) < 0):
        raise InvalidArgument(f"The {name} poses must have rotation matrices.")


def check_poses(
    T_base_flange: Float[np.ndarray, "n 4 4"], T_target_camera: Float[np.ndarray, "n 4 4"]
) -> None:
    """Raise InvalidArgument unless all are rigid motions, and the two sides turned by like angles.

    Whatever the frames, two poses differ by the same angle of rotation for the flange as for the camera.
    """
    check_rigid("commanded", T_base_flange)
    check_rigid("measured", T_target_camera)
    first, second = np.triu_indices(len(T_base_flange), 1)
    if len(first) > 2000:
        chosen = np.random.default_rng(0).permutation(len(first))[:2000]
        first, second = first[chosen], second[chosen]
    flange, camera = (_angles(T[first, :3, :3], T[second, :3, :3]) for T in (T_base_flange, T_target_camera))
    disagreement = float(np.median(np.abs(flange - camera)))
    if disagreement > LARGEST_DISAGREEMENT:
        raise InvalidArgument(
            "Robot and camera do not tell of the same motion: between two poses the commanded turn and the measured "
            f"one differ by {math.degrees(disagreement):.1f}° (median), where a camera on the flange turns as it does.",
            "Check the order and units of roll, pitch, yaw (R = Rz Ry Rx, degrees at the API), that images carry the "
            "right pose_id, and that the target's origin is the same in all images.",
        )


def check_count(count: int) -> None:
    """Raise MotionInsufficient for fewer poses than determine the frames."""
    if count < LEAST_POSES:
        raise MotionInsufficient(
            f"Tying the frames needs at least {LEAST_POSES} poses, got {count}.",
            "Add poses; ten or more, turned by 20° and more about different axes, are a good number.",
        )


def check_motion(T_base_flange: Float[np.ndarray, "n 4 4"]) -> None:
    """Raise MotionInsufficient where the commanded rotations leave the frames undetermined, and say which part."""
    mean = rotation_mean(T_base_flange[:, :3, :3])
    turns = np.array([so3_log(mean.T @ R) for R in T_base_flange[:, :3, :3]])
    _, singular, Vt = np.linalg.svd(turns, full_matrices=False)
    extent = singular / math.sqrt(len(turns))
    if extent[0] < LEAST_ROTATION:
        raise MotionInsufficient(
            "All commanded orientations are the same or nearly so: the position of T_flange_camera is not determined "
            "in any direction, nor that of T_base_target by itself.",
            _ADVICE,
        )
    if extent[1] < LEAST_ROTATION:
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
