"""A robot's Denavit-Hartenberg parameters from a session's poses with their joint angles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from core.errors import (
    Advisory,
    DegenerateGeometry,
    EstimationError,
    InvalidArgument,
    JointAnglesInconsistent,
    PrismaticJoint,
)
from core.geometry import invert
from core.kinematics import (
    FOLDS,
    AxesIdentification,
    HoldOutError,
    Identification,
    JointEstimate,
    ModelChoice,
    ParameterLayout,
    PoseData,
    Sweep,
    TargetTransform,
    check_against_nominal,
    check_angles,
    conditioning_of_chain,
    identify,
    identify_from_axes,
    joint_regions,
    rms,
)
from core.session.estimate import SessionEstimate
from core.session.estimation import estimate_session
from core.session.frame_warnings import gimbal_warnings
from core.session.model import SessionData
from core.session.robot.coupling_proposal import coupling_proposal, stated_coupling
from core.session.robot.frame_step import frame_step_warnings
from core.session.robot.method_agreement import (
    MethodDifference,
    compare_methods,
    compare_with_global,
    disagreements,
)
from core.session.robot.residual_size import farthest, residual_warnings
from core.session.robot.result import JointFigures, RobotIdentification
from core.session.robot.robot_poses import (
    RobotPoses,
    gather_robot_poses,
    with_nominal_orientations,
)
from core.session.robot.sweeps import NamedSweep, select_sweeps, solve_with_start

DEFAULT_TOLERANCE = math.radians(0.02)


def identify_robot(
    data: SessionData,
    estimate: SessionEstimate | None = None,
    *,
    method: str = "global",
    model: ModelChoice = ModelChoice.AUTO,
    tolerance: float = DEFAULT_TOLERANCE,
    sweeps: Sequence[NamedSweep] = (),
    trials: int = 0,
) -> RobotIdentification:
    """Identify a robot's Denavit-Hartenberg parameters, tool and base from a session's poses.

    T_target_camera = T_target_base · forward(chain, q) · T_flange_camera, classic (distal) links, mm and rad. Of a
    fixed camera T_camera_target = T_camera_base · forward(chain, q) · T_flange_target: the result has the target in
    the camera's place on the flange, and the camera in the target's.

    Parameters
    ----------
    data
        The session. Joint angles of an image override those of its pose. Where it holds poses that another instrument
        measured, these are taken.
    estimate
        The session's cameras and poses; None: estimated here with one common camera.
    method
        `global` (all poses at once, together with the errors that they share: of the lens and of the prints), `cpa`,
        `screw` or `combined` (from the axes of sweeps).
    model
        Whether terms beyond the chain count with method `global`; the other methods have the chain alone.
    tolerance
        A sweep of a joint is a largest set of poses whose other joints agree within it, rad.
    sweeps
        Sweeps by their poses; a joint that is named has these alone, those of the others are recognised.
    trials
        Of the sampling that stated uncertainties are compared with, of method `global` and the chain alone; 0: none.

    Raises InvalidArgument for trials with another method or model, MeasuredPosesMissing where there are no images
    either, JointAnglesMissing, TooManyMeasurements, SeveralTargetsOnFlange, SweepJointUnknown, SweepPoseUnknown,
    DegenerateGeometry, and what `core.kinematics` raises where poses or sweeps do not determine the robot. Where the
    poses show a coupling that the robot does not state, warning or refusal names it.
    """
    if trials and method != "global":
        raise InvalidArgument("Only the global method is sampled.", "Ask for method=global.")
    if estimate is None and data.images and not data.measured:
        estimate = estimate_session(with_nominal_orientations(data))
    gathered = gather_robot_poses(data, estimate)
    coupling = coupling_proposal(data, gathered.poses)
    try:
        found = _identified(data, gathered, method, model, tolerance, sweeps, trials)
    except EstimationError as failure:
        if coupling is not None and isinstance(failure, PrismaticJoint):
            # Of coupled joints whose turns cancel, the orientations do not show one: it turns all the same.
            raise JointAnglesInconsistent(coupling.detail, coupling.advice) from failure
        if coupling is not None:
            raise type(failure)(f"{failure.detail} {coupling.detail}", coupling.advice) from failure
        if data.joint_coupling is not None and isinstance(failure, JointAnglesInconsistent):
            raise JointAnglesInconsistent(
                failure.detail,
                f"{failure.advice} Check the joint coupling that the robot states (joint_coupling, PATCH "
                f"/v1/robots/{{robot_id}}), too: {stated_coupling(data.joint_coupling)}.",
            ) from failure
        raise
    bases = [invert(T) for T in found.T_target_base]
    near = gimbal_warnings(found.T_flange_camera, bases, data.camera_mount if found.targets else "robot")
    more = (*near, *(() if coupling is None else (coupling,)))
    return replace(found, warnings=(*found.warnings, *more)) if more else found


def _identified(
    data: SessionData,
    gathered: RobotPoses,
    method: str,
    model: ModelChoice,
    tolerance: float,
    sweeps: Sequence[NamedSweep],
    trials: int,
) -> RobotIdentification:
    known = select_sweeps(data, gathered.poses, sweeps, tolerance)
    check_angles(gathered.poses, known.sweeps)
    warnings = (*gathered.warnings, *known.warnings)
    try:
        if method == "global":
            robot = solve_with_start(
                lambda start: identify(gathered.poses, data.nominal, start=start, model=model, trials=trials),
                gathered.poses,
                data.nominal,
                known.sweeps,
            )
            agreement = compare_methods(robot.joints, gathered.poses, data.nominal, known.sweeps, tolerance)
            more = (*robot.warnings, *disagreements(agreement), *_frame_steps(robot, gathered))
            found = _of_poses(robot, known.sweeps, gathered, agreement, (*warnings, *more))
            return _with_residual_warning(found, gathered.poses, farthest(robot, gathered.poses))
        if data.nominal is not None:
            check_against_nominal(gathered.poses, data.nominal)
        axes = identify_from_axes(
            gathered.poses, data.nominal, method, sweeps=known.sweeps, tolerance=tolerance, folds=FOLDS
        )
        compared, more = compare_with_global(method, axes.joints, gathered.poses, data.nominal, known.sweeps)
        found = _of_axes(axes, gathered, compared, (*warnings, *more))
        return _with_residual_warning(found, gathered.poses)
    except np.linalg.LinAlgError as failure:
        raise DegenerateGeometry(
            "The poses leave the robot's geometry undetermined.",
            "Add poses at other joint angles; thirty that move all joints over their range are a sound beginning.",
        ) from failure


def _frame_steps(found: Identification, gathered: RobotPoses) -> tuple[Advisory, ...]:
    """Return the warnings of frames that moved while poses were measured, by targets."""
    poses, order = gathered.poses, gathered.order
    counted = order[found.used[order]]
    return tuple(
        warning
        for target in np.unique(poses.targets)
        for warning in frame_step_warnings(
            found.residuals[:3], poses.positions_mm, counted[poses.targets[counted] == target], poses.labels
        )
    )


def _with_residual_warning(
    found: RobotIdentification, poses: PoseData, most: Sequence[str] = ()
) -> RobotIdentification:
    more = tuple(residual_warnings(found, poses, most))
    return replace(found, warnings=(*found.warnings, *more)) if more else found


def _of_poses(
    found: Identification,
    sweeps: Sequence[Sweep],
    gathered: RobotPoses,
    agreement: tuple[MethodDifference, ...],
    warnings: tuple[Advisory, ...],
) -> RobotIdentification:
    count = int(found.used.sum())

    def of_joint(joint: JointEstimate) -> JointFigures:
        members = {int(pose) for s in sweeps if s.joint == joint.joint - 1 for pose in s.poses}
        rows = [pose for pose in sorted(members) if found.used[pose]]
        return JointFigures(joint, count, rms(found.residuals[:, rows]) if rows else None)

    return RobotIdentification(
        found.chain,
        found.T_flange_camera,
        found.T_target_base,
        tuple(map(of_joint, found.joints)),
        found.names,
        found.correlation,
        found.residual,
        found.validation,
        found.conditioning,
        found.scatter_position_mm,
        found.scatter_rotation,
        found.null_space,
        found.target_transforms,
        gathered.targets,
        found.flange_camera_covariance,
        found.base_target_covariances,
        found.region,
        found.error_model,
        found.nominal_arm,
        found.chain_residual,
        agreement,
        gathered.excluded,
        warnings,
        found.sampling,
    )


def _of_axes(
    found: AxesIdentification,
    gathered: RobotPoses,
    compared: MethodDifference,
    warnings: tuple[Advisory, ...],
) -> RobotIdentification:
    arcs = found.fits.arcs
    members = np.unique(np.concatenate([arc.sweep.poses[arc.used] for arc in arcs]))
    free = np.flatnonzero(found.identifiable.ravel())
    covariance = found.covariance[np.ix_(free, free)]
    unit = 1.0 / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    keys = ParameterLayout(len(found.joints), 1, 0).keys()

    def of_joint(joint: JointEstimate) -> JointFigures:
        off = np.concatenate([arc.residuals[arc.used] for arc in arcs if arc.sweep.joint == joint.joint - 1])
        return JointFigures(joint, joint.poses, rms(np.ascontiguousarray(off.T)))

    first = min(found.links)
    return RobotIdentification(
        found.chain,
        found.T_flange_camera,
        found.T_target_base,
        tuple(map(of_joint, found.joints)),
        tuple(keys[column] for column in free),
        covariance * np.outer(unit, unit),
        HoldOutError(found.residual_mm, found.residual_rad),
        found.validation,
        conditioning_of_chain(
            gathered.poses.take(members),
            found.chain.as_array(),
            found.T_flange_camera,
            found.T_target_base,
            found.identifiable,
        ),
        found.scatter_mm,
        found.scatter_rad,
        found.null_space,
        tuple(
            TargetTransform(first, target, link.T_first_target, link.covariance, link.pairs)
            for target, link in sorted(found.links.items())
            if target != first
        ),
        gathered.targets,
        None,
        (None,) * len(found.T_target_base),
        joint_regions(gathered.poses.joint_angles[members]),
        None,
        None,
        None,
        (compared,),
        gathered.excluded,
        (*warnings, *found.warnings),
    )
