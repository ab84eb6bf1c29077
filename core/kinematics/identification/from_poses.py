"""Global identification: chain, tool, bases and transforms between targets, from all poses at once.

`identify` takes poses and returns an `Identification` with its covariance. Its steps, in `global_fit`: `placed` puts
the starting chain before the poses in closed form; `fix_gauge` decides which parameters are identifiable; `refine`
fits them robustly together with the robot's own scatter; where axes of the result are parallel, or a direction is
hardly determined, a parameter is held and the fit is repeated; `validate` holds poses out.

Conventions: θ and d of the first joint and all four of the last cannot be separated from base and tool and keep the
nominal's values, or zero; so does d of a joint whose axis is near parallel to the next, where β is fitted instead.
Where all axes are parallel, the flange is level with the measured point. Of equal descriptions that one is reported
which is next to the nominal (`conventions`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from core.errors import (
    DegenerateGeometry,
    InvalidArgument,
    JointNotExcited,
    NotConverged,
    TooFewPoses,
)
from core.kinematics.arm_model import SHORTEST_REACH_MM, THETA, ArmState, D
from core.kinematics.circle_point_analysis import identify_from_axes
from core.kinematics.dh import Chain, forward
from core.kinematics.equal_descriptions import level_with_point
from core.kinematics.error_model import Level, joint_regions
from core.kinematics.frame_covariances import base_target_covariances, flange_camera_covariance
from core.kinematics.global_fit import (
    DEFAULT_SCATTER,
    FOLDS,
    FitResult,
    Gauge,
    Observations,
    conditioning,
    fit_frames,
    fix_gauge,
    linearised,
    observations_of,
    placed,
    refine,
    rms,
    validate,
)
from core.kinematics.identification.consistency import require_consistent
from core.kinematics.identification.conventions import in_reported_form
from core.kinematics.identification.extension import ModelChoice, extend
from core.kinematics.identification.result import Identification
from core.kinematics.identification.sampling import sample_parameters
from core.kinematics.joint_angle_checks import check_angles, check_joints
from core.kinematics.nominal_checks import check_against_nominal
from core.kinematics.pose_observations import PoseData
from core.kinematics.results import joint_estimates, model_warnings, warnings_for
from core.kinematics.sweeps import find_sweeps
from core.kinematics.target_transforms import target_transforms
from core.numerics import SMALLEST, Variances

MIN_JOINT_RANGE = math.radians(1.0)
MAX_ROUNDS = 3


@dataclass(frozen=True, slots=True)
class Solution:
    """A fit with the gauge it was made in; what `identify` reports from."""

    refined: FitResult
    gauge: Gauge


def identify(
    poses: PoseData,
    nominal: Chain | None = None,
    *,
    start: Chain | None = None,
    folds: int = FOLDS,
    model: ModelChoice = ModelChoice.DH,
    trials: int = 0,
) -> Identification:
    """Identify the robot from poses at known joint angles.

    Parameters
    ----------
    nominal
        The robot as its maker describes it: parameters that are not identifiable keep its values, and the result is
        compared with it.
    start
        Where to begin; the nominal if not given, and without one the chain that sweeps give by the combined method.
    folds
        Parts that poses are dealt into for validation; 0 for none.
    model
        Whether terms beyond the chain count: in the uncertainties of its parameters, and in predictions.
    trials
        Of the sampling that the stated covariance is compared with (`sampling`); 0 for none. It is of the chain alone.

    Raises InvalidArgument for trials with terms beyond the chain,
    JointAnglesInconsistent for a chain of another number of joints or poses that no such arm explains,
    JointAnglesUnitMismatch and LengthsUnitMismatch where units were confused, JointNotExcited, TooFewPoses,
    NotConverged; without nominal and start what `identify_from_axes` raises.
    """
    seen = observations_of(poses)
    begin = _initial_chain(poses, nominal, start)
    arm = placed(begin.as_array(), forward(begin, poses.joint_angles), seen)
    solution = solve(arm, seen, poses, nominal)
    return _report(solution, seen, poses, nominal, folds, model, trials)


def _require_anything(gauge: Gauge) -> None:
    if not gauge.free.any():
        raise DegenerateGeometry(
            "The poses are too uncertain to determine any of the robot's parameters.",
            "Check the unit of their covariances: mm² and rad².",
        )


def solve(
    arm: ArmState,
    seen: Observations,
    poses: PoseData,
    nominal: Chain | None = None,
) -> Solution:
    """Fit from an arm, choosing what to fit on the way; the result is described as the nominal is."""
    _require_enough(seen)
    scatter: Variances | None = None
    gauge = fix_gauge(arm, seen, SMALLEST if seen.own.any() else DEFAULT_SCATTER)
    _require_anything(gauge)
    length = max(arm.links_mm, SHORTEST_REACH_MM)
    for _ in range(MAX_ROUNDS):
        arm = level_with_point(arm, gauge.free, gauge.parallel)
        refined = refine(arm, seen, gauge.free, scatter)
        require_consistent(refined, length, poses, nominal)
        refined = in_reported_form(refined, gauge, seen, nominal)
        again = fix_gauge(refined.arm, seen, refined.scatter, gauge.parallel)
        if np.array_equal(again.free, gauge.free):
            break
        gauge, scatter = again, refined.scatter
        _require_anything(gauge)
        arm = _regauged(refined.arm, arm, gauge)
    else:  # unsettled: what is identifiable alternates; the figures are of the last gauge
        refined = refine(level_with_point(arm, gauge.free, gauge.parallel), seen, gauge.free, scatter)
        require_consistent(refined, length, poses, nominal)
        refined = in_reported_form(refined, gauge, seen, nominal)
    if refined.status != "converged":
        raise NotConverged(
            "The identification did not converge.",
            "Check the joint angles and the nominal; begin from sweeps (combined) where the nominal is far off.",
        )
    return Solution(refined, gauge)


def _report(
    solution: Solution,
    seen: Observations,
    poses: PoseData,
    nominal: Chain | None,
    folds: int,
    model: ModelChoice = ModelChoice.DH,
    trials: int = 0,
) -> Identification:
    """Return the identification that a fit gives, with its joints, validation and warnings."""
    if trials and model is not ModelChoice.DH:
        raise InvalidArgument(
            "Sampling draws from the chain alone; with terms beyond it the uncertainties are not of that model.",
            "Ask for model=dh.",
        )
    refined, gauge = solution.refined, solution.gauge
    used = np.flatnonzero(refined.used)
    compared = None
    if nominal is not None:
        compared = fit_frames(nominal.as_array(), refined.arm, seen.take(used), gauge.free, refined.scatter)
    labels = [poses.labels[i] for i in used] if poses.labels else []
    extension, validation = None, None
    if model is not ModelChoice.DH:
        extension = extend(refined, gauge, seen, nominal, compared, folds, labels, model)
        refined, gauge, validation = extension.refined, extension.gauge, extension.validation
        used = np.flatnonzero(refined.used)
    elif folds > 1:
        validation = validate(
            refined.arm,
            compared,
            seen.take(used),
            gauge.free,
            refined.scatter,
            folds,
            len(seen) - len(used),
            labels,
        )
    arm, layout = refined.arm, refined.arm.layout
    alone = None
    if extension is not None and extension.model.level is not Level.DH:
        some = seen.take(used)
        alone = rms(linearised(fit_frames(arm.parameters, arm, some, gauge.free, refined.scatter), some)[0])
    kinematic = int(gauge.free.sum())
    covariance = refined.covariance[:kinematic, :kinematic]
    if extension is None:
        open_ones = gauge.by_assumed[gauge.free]
        covariance = covariance + open_ones @ open_ones.T
    how = conditioning(arm, refined.jacobian, gauge.free, refined.used)
    keys = layout.keys()
    return Identification(
        chain=arm.chain,
        T_flange_camera=arm.T_flange_camera,
        T_target_base=arm.T_target_base,
        joints=joint_estimates(arm, gauge, covariance, nominal, poses.joint_angles[used]),
        names=tuple(keys[c] for c in np.flatnonzero(gauge.free)),
        covariance=covariance,
        target_transforms=target_transforms(arm, gauge.free, covariance, seen.target[used]),
        scatter_position_mm=math.sqrt(refined.scatter.position),
        scatter_rotation=math.sqrt(refined.scatter.rotation) if seen.components == 6 else None,
        residual=rms(refined.residuals[:, used]),
        residuals=refined.residuals,
        used=refined.used,
        conditioning=how,
        null_space=gauge.unidentifiable,
        flange_camera_covariance=flange_camera_covariance(arm, gauge.free, covariance),
        base_target_covariances=base_target_covariances(arm, gauge.free, covariance),
        validation=validation,
        region=joint_regions(poses.joint_angles[used]),
        error_model=None if extension is None else extension.model,
        nominal_arm=compared,
        chain_residual=alone,
        warnings=(
            *warnings_for(refined, gauge, how, validation, poses, nominal),
            *(() if extension is None else model_warnings(extension.model)),
        ),
        sampling=sample_parameters(refined, seen, gauge.free, trials) if trials else None,
    )


def _initial_chain(poses: PoseData, nominal: Chain | None, start: Chain | None) -> Chain:
    """Return the chain to begin at, with the nominal's values where frames make a parameter a convention."""
    for given in (start, nominal):
        check_joints(poses, given)
    if not len(poses):
        raise TooFewPoses("There are no poses.")
    if nominal is not None:
        check_against_nominal(poses, nominal)
    arcs = np.ptp(poses.joint_angles, axis=0)
    resting = np.flatnonzero(arcs < MIN_JOINT_RANGE)
    if len(resting):
        check_angles(poses, find_sweeps(poses))
        which = f"joint{'s' if len(resting) > 1 else ''} {', '.join(str(i + 1) for i in resting)}"
        raise JointNotExcited(
            f"Over all poses {which} moved by less than {math.degrees(MIN_JOINT_RANGE):g}°."
        )
    if start is None and nominal is not None:
        return nominal
    parameters = (identify_from_axes(poses).chain if start is None else start).as_array()
    convention = np.zeros_like(parameters) if nominal is None else nominal.as_array()
    parameters[0, [D, THETA]] = convention[0, [D, THETA]]
    parameters[-1] = convention[-1]
    return Chain.from_array(parameters)


def _require_enough(seen: Observations) -> None:
    """Raise TooFewPoses where poses give too few equations: an arm has four unknowns a joint and six a target."""
    unknown, equations = 4 * seen.layout.joints + 6 * len(np.unique(seen.target)), len(seen) * seen.components
    if equations < 1.2 * unknown:
        least = math.ceil(1.2 * unknown / seen.components)
        raise TooFewPoses(
            f"{len(seen)} poses do not determine {unknown} parameters: {least} are the least, three times as many "
            "are sound."
        )


def _regauged(arm: ArmState, start: ArmState, gauge: Gauge) -> ArmState:
    """Return the arm with newly held columns of the chain at the start's values."""
    held = ~gauge.free[: arm.layout.tool.start].reshape(-1, 5)
    return replace(arm, parameters=np.where(held, start.parameters, arm.parameters))
