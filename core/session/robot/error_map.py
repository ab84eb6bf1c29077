"""Where a session's robot is off its nominal chain, over the workspace."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.errors import InvalidArgument, NominalRobotMissing
from core.kinematics import KinematicErrorMap, map_kinematic_error
from core.session.estimate import SessionEstimate
from core.session.model import SessionData
from core.session.robot.identification import identify_robot
from core.session.robot.result import RobotIdentification


@dataclass(frozen=True, slots=True)
class SessionErrorMap:
    """The map, what was identified, and of every joint whether the workspace ends at its stated limits, or at where the
    poses were.
    """

    map: KinematicErrorMap
    found: RobotIdentification
    limits_stated: tuple[bool, ...]


def session_error_map(
    data: SessionData, estimate: SessionEstimate | None = None, *, limits: Float[np.ndarray, "2 j"]
) -> SessionErrorMap:
    """Map the position error of the session's nominal robot; `limits` are those of its stated joint angles, degrees.

    Raises NominalRobotMissing for a session without a robot, and as `identify_robot` does.
    """
    if data.nominal is None:
        raise NominalRobotMissing(
            "The error is that of a robot's data sheet, and the session names no robot."
        )
    found = identify_robot(data, estimate)
    model, nominal = found.error_model, found.nominal_arm
    if model is None or nominal is None:
        raise InvalidArgument("Without a model of the identified robot there is nothing to compare.")
    ends, stated = workspace_limits(data, limits, model.fit.design.seen.joint_angles[model.fit.used])
    return SessionErrorMap(map_kinematic_error(model, nominal, ends), found, stated)


def workspace_limits(
    data: SessionData, limits: Float[np.ndarray, "2 j"], measured: Float[np.ndarray, "n j"]
) -> tuple[Float[np.ndarray, "2 j"], tuple[bool, ...]]:
    """Return where the workspace ends, by the chain's angles (rad), and which limits are the robot's own.

    Parameters
    ----------
    limits
        Of the stated joint angles, degrees; infinite where the robot states none.
    measured
        The chain's angles (rad) that were measured: they end the workspace where no limit does.
    """
    seen = np.stack([measured.min(axis=0), measured.max(axis=0)])
    if data.joint_coupling is not None:  # limits of stated angles bound no single angle of the chain
        return seen, (False,) * seen.shape[1]
    stated = np.isfinite(limits).all(axis=0)
    return np.where(stated, np.radians(limits), seen), tuple(stated.tolist())
