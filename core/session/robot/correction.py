"""Commands corrected by what a session identified of its robot."""

from __future__ import annotations

from dataclasses import dataclass

from core.errors import GridposeError, InvalidArgument
from core.kinematics import (
    MAX_CONFIRMING_RATIO,
    CorrectionModel,
    Level,
    correction_model,
    curves_ratio,
)
from core.session.estimate import SessionEstimate
from core.session.model import SessionData
from core.session.robot.identification import identify_robot
from core.session.robot.result import RobotIdentification


@dataclass(frozen=True, slots=True)
class SessionCorrection:
    """What corrects commands, and whether joint curves count in it.

    `confirming_ratio` is the second session's position error with the first one's curves by that without them; None
    where no second session was named, it is too small, or it cannot be identified (`confirming_failure`: the code).
    """

    by: CorrectionModel
    found: RobotIdentification
    confirming_ratio: float | None
    confirming_failure: str | None

    @property
    def curves_applied(self) -> bool:
        """Whether joint curves are part of the correction."""
        return self.by.level is Level.ALL


def session_correction(
    data: SessionData,
    estimate: SessionEstimate | None = None,
    *,
    curves: bool = False,
    second: SessionData | None = None,
) -> SessionCorrection:
    """Return what corrects commands of a session's robot.

    Curves of gears count where `curves` asks for them, or the `second` session of the same robot confirms them; else
    the chain corrects, with compliance where this predicts better.

    Raises InvalidArgument for a session without a nominal robot, and as `identify_robot` does.
    """
    found = identify_robot(data, estimate)
    model, nominal = found.error_model, found.nominal_arm
    if model is None or nominal is None:
        raise InvalidArgument("Without a nominal robot there is no model that commands are meant in.")
    ratio, failure = None, None
    if second is not None and not curves and model.level is Level.ALL:
        with_curves = correction_model(model, nominal, found.validation, curves=True)
        try:
            other = identify_robot(second).error_model
            ratio = None if other is None else curves_ratio(with_curves, other)
        except GridposeError as error:
            failure = error.code
        curves = ratio is not None and ratio < MAX_CONFIRMING_RATIO
    by = correction_model(model, nominal, found.validation, curves=curves)
    return SessionCorrection(by, found, ratio, failure)
