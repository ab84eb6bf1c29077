"""The model of a calibrated arm, and the order of its parameters in Jacobians and covariances.

    T_target_camera = T_target_base · T_base_flange(q) · T_flange_camera

Columns: `JOINT_PARAMETERS` of every joint; tool x, y, z and its rotation from the left (flange frame); base x, y, z and
its rotation from the left (target frame), once for each target; then the errors that all poses share, in their own
standard deviations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.geometry import so3_exp, transform
from core.kinematics.dh import JOINT_PARAMETERS, Chain

A, ALPHA, D, THETA, BETA = range(5)
_WORDS = ("a{}", "alpha{}", "d{}", "theta{} offset", "beta{}")
_AXES = ("x", "y", "z", "rotation x", "rotation y", "rotation z")
_FRAME_KEYS = ("x_mm", "y_mm", "z_mm", "rotation_x_rad", "rotation_y_rad", "rotation_z_rad")
FLANGE_CAMERA = "flange_camera"
SHORTEST_REACH_MM = 100.0
NOMINAL_LENGTH_MM, NOMINAL_ANGLE_RAD = 1.0, math.radians(0.1)
"""Standard deviations of DH parameters about the nominal: what workshops and assembly leave."""


@dataclass(frozen=True, slots=True)
class ParameterLayout:
    """How many joints, targets and shared errors there are, and thereby which column is what."""

    joints: int
    targets: int
    shared: int

    @property
    def kinematic(self) -> int:
        """The number of columns without the shared errors."""
        return 5 * self.joints + 6 + 6 * self.targets

    @property
    def size(self) -> int:
        return self.kinematic + self.shared

    @property
    def tool(self) -> slice:
        return slice(5 * self.joints, 5 * self.joints + 6)

    def base(self, target: int) -> slice:
        first = 5 * self.joints + 6 + 6 * target
        return slice(first, first + 6)

    def column(self, joint: int, parameter: int) -> int:
        """Return the column of a joint's parameter; joints count from 0."""
        return 5 * joint + parameter

    def joint_of(self, column: int) -> int | None:
        """Return the joint a column belongs to, or None for the tool and the bases."""
        return column // 5 if column < 5 * self.joints else None

    def names(self) -> tuple[str, ...]:
        """Return the words for every column; joints and targets count from 1."""
        found = [word.format(i + 1) for i in range(self.joints) for word in _WORDS]
        found += [f"tool {axis}" for axis in _AXES]
        for target in range(self.targets):
            which = f" {target + 1}" if self.targets > 1 else ""
            found += [f"base{which} {axis}" for axis in _AXES]
        return (*found, *(f"shared {k + 1}" for k in range(self.shared)))

    def keys(self) -> tuple[str, ...]:
        """Return a key for every column but the shared errors, with its unit: `joint_2.a_mm`, `flange_camera.x_mm`,
        `target_base.rotation_z_rad`; joints and, where there are several, targets count from 1.
        """
        found = [f"joint_{i + 1}.{name}" for i in range(self.joints) for name in JOINT_PARAMETERS]
        for frame in (FLANGE_CAMERA, *(self.base_key(target) for target in range(self.targets))):
            found += [f"{frame}.{axis}" for axis in _FRAME_KEYS]
        return tuple(found)

    def base_key(self, target: int) -> str:
        """Return the key of a target's base transform."""
        return f"target_base_{target + 1}" if self.targets > 1 else "target_base"

    def units(self, reach_mm: float) -> Float[np.ndarray, " p"]:
        """Return steps of like weight: 1 mm, and the angle that moves the end of the arm by 1 mm."""
        angle = 1.0 / reach_mm
        of_frame = [1.0] * 3 + [angle] * 3
        of_joint = [angle if name.endswith("_rad") else 1.0 for name in JOINT_PARAMETERS]
        return np.array(of_joint * self.joints + of_frame * (1 + self.targets) + [1.0] * self.shared)

    def nominal_deviations(self) -> Float[np.ndarray, " c"]:
        """Return the standard deviations of the joints' parameters about the nominal."""
        angles = [name.endswith("_rad") for name in JOINT_PARAMETERS] * self.joints
        return np.where(angles, NOMINAL_ANGLE_RAD, NOMINAL_LENGTH_MM)


@dataclass(frozen=True, slots=True)
class ArmState:
    """A state of the fit: chain, tool, a base for each target, shared errors in their standard deviations."""

    parameters: Float[np.ndarray, "j 5"]
    T_flange_camera: Float[np.ndarray, "4 4"]
    T_target_base: Float[np.ndarray, "t 4 4"]
    shared: Float[np.ndarray, " k"]

    @property
    def layout(self) -> ParameterLayout:
        return ParameterLayout(len(self.parameters), len(self.T_target_base), len(self.shared))

    @property
    def chain(self) -> Chain:
        return Chain.from_array(self.parameters)

    @property
    def reach_mm(self) -> float:
        """The length of the chain, with the tool: what an angle's error is seen at."""
        return max(self.links_mm + float(np.linalg.norm(self.T_flange_camera[:3, 3])), SHORTEST_REACH_MM)

    @property
    def links_mm(self) -> float:
        """The length of the chain by itself."""
        return float(np.abs(self.parameters[:, [A, D]]).sum())

    def moved(self, step: Float[np.ndarray, " p"]) -> ArmState:
        """Return the arm after a step in the order of the columns."""
        layout = self.layout
        of_chain = step[: 5 * layout.joints].reshape(-1, 5)
        return replace(
            self,
            parameters=self.parameters + of_chain,
            T_flange_camera=_moved(self.T_flange_camera, step[layout.tool]),
            T_target_base=np.array(
                [_moved(T, step[layout.base(t)]) for t, T in enumerate(self.T_target_base)]
            ),
            shared=self.shared + step[layout.kinematic :],
        )


def _moved(T: Float[np.ndarray, "4 4"], step: Float[np.ndarray, "6"]) -> Float[np.ndarray, "4 4"]:
    if not step.any():
        return T
    R = so3_exp(step[3:]) @ T[:3, :3]
    # R is orthonormal but for rounding: one Newton step towards its polar factor squares what it is off by, and costs
    # a tenth of a singular value decomposition.
    return transform(1.5 * R - 0.5 * R @ (R.T @ R), T[:3, 3] + step[:3])
