"""Which model corrects commands, how sure it is, and what it gains on poses that were held out.

A command is meant in the controller's own model, the nominal chain. Base and tool of that chain are those that suit the
measured poses best, so that a correction is what no choice of base and tool removes. The end that is meant is then

    T_target_camera = T_target_base · forward(nominal, q) · T_flange_camera

and the end that is attained is that of the identified arm with its terms. Curves of gears count only where they are
asked for: on many arms they hold within a session and not in the next, while the chain and compliance last.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.geometry import rotations_from_vectors
from core.kinematics.arm_model import ArmState
from core.kinematics.dh import chain_frames
from core.kinematics.error_model import (
    ErrorModel,
    JointRegion,
    Level,
    chosen_level,
    growth,
    hold_out,
    joint_regions,
    of_poses,
    variances,
)
from core.kinematics.global_fit import (
    FOLDS,
    Blocking,
    HoldOutError,
    Validation,
    assign_folds,
    blocks_of,
    rms,
)


@dataclass(frozen=True, slots=True)
class CorrectionErrors:
    """Errors of the identified and of the nominal arm at the same held-out poses.

    What a corrected command is off by, and what an uncorrected one is. `corrected` is None where poses are too few to
    hold any out.
    """

    corrected: HoldOutError | None
    nominal: HoldOutError | None

    @property
    def position_ratio(self) -> float | None:
        """Corrected by nominal; None where either is not known."""
        if self.corrected is None or self.nominal is None or self.nominal.position_rms_mm == 0.0:
            return None
        return self.corrected.position_rms_mm / self.nominal.position_rms_mm


@dataclass(frozen=True, slots=True)
class CorrectionModel:
    """The arm that corrects commands.

    Parameters
    ----------
    model, level
        The identified arm with its terms, and those of them that count.
    nominal
        The controller's model, with base and tool where it suits the poses best; its tool is turned as the identified
        arm's where positions alone were measured.
    growth
        Of stated deviations of predictions: positions, rotations.
    random, blocked
        Errors at folds dealt at random, and at clusters of joint space.
    region
        Where each joint was: commands outside are not corrected.
    """

    model: ErrorModel
    level: Level
    nominal: ArmState
    growth: Float[np.ndarray, " k"]
    random: CorrectionErrors
    blocked: CorrectionErrors
    region: tuple[JointRegion, ...]

    def meant(self, joint_angles: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n 4 4"]:
        """Return where the controller means to be at these joint angles (rad)."""
        return poses_of(self.nominal, joint_angles)

    def attained(self, joint_angles: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n 4 4"]:
        """Return where the identified arm is at these joint angles (rad)."""
        return attained_poses(self.model, self.level, joint_angles)

    def deviations(self, joint_angles: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "k n"]:
        """Return the expected lengths of the error of position (mm) and, where known, of rotation (rad), whichever side
        the joints come from.
        """
        stated = predicted_variances(self.model, self.level, joint_angles)
        lengths = np.sqrt(stated.reshape(len(self.growth), 3, -1).sum(axis=1))
        return np.asarray(self.growth[:, None] * lengths)


def correction_model(
    model: ErrorModel, nominal: ArmState, validation: Validation | None, *, curves: bool
) -> CorrectionModel:
    """Return what corrects commands.

    Parameters
    ----------
    model, validation
        The identification of all poses; without a validation the chain alone corrects.
    nominal
        The nominal chain at its best base and tool.
    curves
        Whether the terms of gears and axes count, where the poses speak for them; else the chain and compliance.
    """
    fit, problem = model.fit, model.fit.design
    q = problem.seen.joint_angles
    if problem.seen.components == 3:
        tool = nominal.T_flange_camera.copy()
        tool[:3, :3] = problem.arm.T_flange_camera[:3, :3]
        nominal = replace(nominal, T_flange_camera=tool)
    region = joint_regions(q[fit.used])
    unknown = CorrectionErrors(None, None)
    if validation is None:
        return CorrectionModel(model, Level.DH, nominal, np.ones(problem.kinds), unknown, unknown, region)
    folds, clusters = assign_folds(q, FOLDS), blocks_of(problem.arm, q).get(Blocking.CLUSTERS)
    left = hold_out(fit, folds, list(Level)).residuals
    errors = {level: _rms(model, residuals) for level, residuals in left.items()}
    level = Level.ALL
    if not curves or model.level is not Level.ALL:
        lasting = (Level.DH, Level.COMPLIANCE)
        level = chosen_level(
            replace(fit, levels={one: fit.levels[one] for one in lasting}),
            {one: errors[one] for one in lasting},
        )
    blocked = unknown
    if clusters is None:
        grown = growth(fit, folds, level)
    else:
        nominals = [block.nominal for block in validation.blocks if block.blocking is Blocking.CLUSTERS]
        apart = hold_out(fit, clusters, [level], growth_of=level)
        assert apart.growth is not None
        grown = apart.growth
        blocked = CorrectionErrors(_rms(model, apart.residuals[level]), nominals[0] if nominals else None)
    return CorrectionModel(
        model,
        level,
        nominal,
        grown,
        CorrectionErrors(errors[level], validation.nominal),
        blocked,
        region,
    )


def _rms(model: ErrorModel, residuals: Float[np.ndarray, "m n"]) -> HoldOutError:
    problem = model.fit.design
    return rms(of_poses(problem, residuals)[:, model.fit.used[problem.visit]])


def poses_of(arm: ArmState, joint_angles: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n 4 4"]:
    """Return T_target_camera of an arm before its first target, at joint angles in rad."""
    flange = chain_frames(arm.parameters, joint_angles)[:, -1]
    return np.asarray(arm.T_target_base[0] @ flange @ arm.T_flange_camera)


def attained_poses(
    model: ErrorModel, level: Level, joint_angles: Float[np.ndarray, "n j"]
) -> Float[np.ndarray, "n 4 4"]:
    """Return where the identified arm is at joint angles (rad), by the terms of a level."""
    problem = model.fit.design
    poses = poses_of(problem.arm, joint_angles)
    b = model.fit.levels[level].coefficients
    step = np.zeros((6, len(poses)))
    asked = problem.at(joint_angles, components=6)
    for some in asked.blocks(np.arange(len(poses))):
        step[:, some] = np.einsum("pmn,p->mn", asked.rows(some), b)
    poses[:, :3, 3] += step[:3].T
    poses[:, :3, :3] = rotations_from_vectors(step[3:].T) @ poses[:, :3, :3]
    return poses


def predicted_variances(
    model: ErrorModel, level: Level, joint_angles: Float[np.ndarray, "n j"]
) -> Float[np.ndarray, "m n"]:
    """Return the variances (mm², then rad²) of one more measurement about `attained_poses`, whichever side the joints
    come from, before they grow by what held-out poses are off.
    """
    problem, fitted = model.fit.design, model.fit.levels[level]
    asked = problem.at(joint_angles, components=problem.seen.components)
    stated = np.empty((problem.seen.components, len(joint_angles)))
    for some in asked.blocks(np.arange(len(joint_angles))):
        stated[:, some] = variances(asked.rows(some), fitted) + asked.by_unknown_moves(some, fitted)
    return np.asarray(stated + model.fit.visit_scatter_of(level).diagonal(len(stated))[:, None])
