"""Denavit-Hartenberg chains: forward kinematics, and how the end's pose changes with every parameter.

The classic (distal) convention, with Hayati's second turn β for neighbouring axes that are near parallel:

    T_{i-1,i} = Rz(θ_i + offset_i) Tz(d_i) Tx(a_i) Rx(α_i) Ry(β_i)

so that joint i turns about the z axis of frame i-1. Where axes i and i+1 are parallel, d_i may be anything: it is then
kept at what it is, and β_i takes its place (Hayati's form has no Tz; a d_i that is held is the same form with its
origin moved along the axis). Elsewhere β_i = 0. Lengths in mm, angles in rad.

References: J. Denavit, R. S. Hartenberg, J. Appl. Mech. 22 (1955) 215-221; S. A. Hayati, "Robot arm geometric link
parameter estimation", CDC 1983.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from jaxtyping import Float

from core.errors import InvalidArgument
from core.jit import jit

JOINT_PARAMETERS = ("a_mm", "alpha_rad", "d_mm", "theta_offset_rad", "beta_rad")
"""Names and order of one joint's parameters in every array and covariance."""
LARGEST_SIGMA_D_MM = 1.0
PARALLEL_AT_MOST = 0.2  # sine of the angle: beyond it poor data, not the axes' direction, make d uncertain


@dataclass(frozen=True, slots=True)
class JointParameters:
    """What one joint and the link after it contribute; field order is `JOINT_PARAMETERS`."""

    a_mm: float
    alpha_rad: float
    d_mm: float
    theta_offset_rad: float
    beta_rad: float = 0.0

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) for value in astuple(self)):
            raise InvalidArgument("Every DH parameter must be a finite number.")


@dataclass(frozen=True, slots=True)
class Chain:
    """Revolute joints in a row, from the base to the flange."""

    joints: tuple[JointParameters, ...]

    def __post_init__(self) -> None:
        if not self.joints:
            raise InvalidArgument("A chain needs at least one joint.")

    def __len__(self) -> int:
        return len(self.joints)

    def as_array(self) -> Float[np.ndarray, "j 5"]:
        """Return the parameters, a row per joint in the order of `JOINT_PARAMETERS`."""
        rows = [(j.a_mm, j.alpha_rad, j.d_mm, j.theta_offset_rad, j.beta_rad) for j in self.joints]
        return np.array(rows, dtype=np.float64)

    @classmethod
    def from_array(cls, parameters: Float[np.ndarray, "j 5"]) -> Chain:
        """Make a chain from rows in the order of `JOINT_PARAMETERS`."""
        return cls(tuple(JointParameters(*(float(value) for value in row)) for row in parameters))

    @classmethod
    def from_rows(cls, rows: Sequence[tuple[float, float, float, float]]) -> Chain:
        """Make a chain from (a mm, α °, d mm, θ offset °) per joint, as data sheets have it."""
        return cls(
            tuple(
                JointParameters(float(a), math.radians(alpha), float(d), math.radians(offset))
                for a, alpha, d, offset in rows
            )
        )


def nearly_parallel(alpha_rad: float, sigma_d_mm: float) -> bool:
    """Whether β has to stand for d between neighbouring axes at the angle α, where d would be uncertain by σ_d.

    The foot of a common normal slides along the axis by 1/sin α of what moves either axis across, so that σ_d grows
    without bound as axes become parallel while every pose stays as well known. How near is too near depends on the
    measurement: the decision is by the predicted σ_d, or the nominal robot's, where that states β. Axes at a fair angle
    are never called parallel.
    """
    return abs(math.sin(alpha_rad)) < PARALLEL_AT_MOST and not sigma_d_mm <= LARGEST_SIGMA_D_MM


def frames(chain: Chain, joint_angles: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n k 4 4"]:
    """Return T_base_frame of every frame, the base itself first (k = j + 1), for joint angles in rad.

    Raises InvalidArgument where the number of joint angles is not that of the joints.
    """
    return chain_frames(chain.as_array(), joint_angles)


def forward(chain: Chain, joint_angles: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n 4 4"]:
    """Return T_base_flange for joint angles in rad."""
    return np.ascontiguousarray(frames(chain, joint_angles)[:, -1])


def chain_frames(
    parameters: Float[np.ndarray, "j 5"], joint_angles: Float[np.ndarray, "n _"]
) -> Float[np.ndarray, "n k 4 4"]:
    """`frames` for parameters as rows in the order of `JOINT_PARAMETERS`."""
    count, joints = joint_angles.shape
    if joints != len(parameters):
        raise InvalidArgument(
            f"There are {joints} joint angles for a chain of {len(parameters)} joints.",
            "Give one angle per joint, first joint first.",
        )
    links = np.array([link_transform(a, alpha, d, beta) for a, alpha, d, _, beta in parameters.tolist()])
    result = np.empty((count, joints + 1, 4, 4))
    turned = np.ascontiguousarray(joint_angles + parameters[:, 3], dtype=np.float64)
    multiply_links(links.reshape(joints, 4, 4), turned, result)
    return result


@jit("f8[:, :, ::1], f8[:, ::1], f8[:, :, :, ::1]")
def multiply_links(
    links: Float[np.ndarray, "j 4 4"], turns: Float[np.ndarray, "n j"], products: Float[np.ndarray, "n k 4 4"]
) -> None:
    """Write the unit matrix and, joint by joint, the product so far times Rz(turn) times the joint's link."""
    for n in range(turns.shape[0]):
        for row in range(4):
            for column in range(4):
                products[n, 0, row, column] = 1.0 if row == column else 0.0
        for i in range(turns.shape[1]):
            cosine, sine = np.cos(turns[n, i]), np.sin(turns[n, i])
            for row in range(4):
                x, y = products[n, i, row, 0], products[n, i, row, 1]
                along, across = cosine * x + sine * y, cosine * y - sine * x
                for column in range(4):
                    products[n, i + 1, row, column] = (
                        along * links[i, 0, column]
                        + across * links[i, 1, column]
                        + products[n, i, row, 2] * links[i, 2, column]
                        + products[n, i, row, 3] * links[i, 3, column]
                    )


def link_transform(a: float, alpha: float, d: float, beta: float) -> Float[np.ndarray, "4 4"]:
    """Return Tz(d) Tx(a) Rx(α) Ry(β); angles in rad, the translation in the unit of a and d."""
    ca, sa, cb, sb = math.cos(alpha), math.sin(alpha), math.cos(beta), math.sin(beta)
    return np.array(
        [[cb, 0.0, sb, a], [sa * sb, ca, -sa * cb, 0.0], [-ca * sb, sa, ca * cb, d], [0.0, 0.0, 0.0, 1.0]]
    )


@jit("f8[:, ::1], f8[:, ::1], f8[:, :, ::1], f8[:, ::1]")
def pose_with_jacobian(
    parameters: Float[np.ndarray, "j 5"],
    joint_angles: Float[np.ndarray, "n j"],
    T_target_base: Float[np.ndarray, "n 4 4"],
    T_flange_camera: Float[np.ndarray, "4 4"],
) -> tuple[Float[np.ndarray, "n 4 4"], Float[np.ndarray, "p 6 n"]]:
    """Return T_target_camera and its derivatives by everything it hangs on, in one pass: what an identification spends
    its time on.

    A pose changes by (p', w'): its position by p' (mm), its rotation R to exp(w') R, both in the target frame. The
    p = 5 j + 12 rows: every joint's parameters in the order of `JOINT_PARAMETERS`; the tool's (p, w), T_flange_camera's
    rotation turned from the left, in the flange frame; then the base's (p, w), likewise, in the target frame. Poses
    run along the last axis.

    With o and z the origin and axis of a turn and p the end, p' = z × (p - o), w' = z; a shift along x gives p' = x.
    """
    count, joints = joint_angles.shape
    end = np.empty((count, 4, 4))
    J = np.zeros((5 * joints + 12, 6, count))
    R = np.empty((joints + 1, 3, 3))
    o = np.empty((joints + 1, 3))
    x = np.empty((joints, 3))
    p = np.empty(3)
    for n in range(count):
        for k in range(3):
            o[0, k] = T_target_base[n, k, 3]
            for m in range(3):
                R[0, k, m] = T_target_base[n, k, m]
        for i in range(joints):
            a, alpha, d, beta = parameters[i, 0], parameters[i, 1], parameters[i, 2], parameters[i, 4]
            theta = joint_angles[n, i] + parameters[i, 3]
            ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
            cb, sb = np.cos(beta), np.sin(beta)
            for k in range(3):
                along = ct * R[i, k, 0] + st * R[i, k, 1]
                across = ct * R[i, k, 1] - st * R[i, k, 0]
                z = R[i, k, 2]
                y, up = ca * across + sa * z, ca * z - sa * across
                x[i, k] = along
                R[i + 1, k, 0] = cb * along - sb * up
                R[i + 1, k, 1] = y
                R[i + 1, k, 2] = sb * along + cb * up
                o[i + 1, k] = o[i, k] + a * along + d * z
        for k in range(3):
            p[k] = o[joints, k]
            for m in range(3):
                p[k] += R[joints, k, m] * T_flange_camera[m, 3]
                end[n, k, m] = 0.0
                for h in range(3):
                    end[n, k, m] += R[joints, k, h] * T_flange_camera[h, m]
            end[n, k, 3], end[n, 3, k] = p[k], 0.0
        end[n, 3, 3] = 1.0
        for k in range(3):
            s, t = (k + 1) % 3, (k + 2) % 3
            for i in range(joints):
                row = 5 * i
                J[row, k, n] = x[i, k]
                J[row + 1, k, n] = x[i, s] * (p[t] - o[i + 1, t]) - x[i, t] * (p[s] - o[i + 1, s])
                J[row + 1, 3 + k, n] = x[i, k]
                J[row + 2, k, n] = R[i, k, 2]
                J[row + 3, k, n] = R[i, s, 2] * (p[t] - o[i, t]) - R[i, t, 2] * (p[s] - o[i, s])
                J[row + 3, 3 + k, n] = R[i, k, 2]
                J[row + 4, k, n] = R[i + 1, s, 1] * (p[t] - o[i + 1, t]) - R[i + 1, t, 1] * (
                    p[s] - o[i + 1, s]
                )
                J[row + 4, 3 + k, n] = R[i + 1, k, 1]
            tool, base = 5 * joints, 5 * joints + 6
            for m in range(3):
                J[tool + m, k, n] = R[joints, k, m]
                J[tool + 3 + m, 3 + k, n] = R[joints, k, m]
            J[base + k, k, n] = J[base + 3 + k, 3 + k, n] = 1.0
            J[base + 3 + s, k, n] = p[t] - o[0, t]
            J[base + 3 + t, k, n] = o[0, s] - p[s]
    return end, J
