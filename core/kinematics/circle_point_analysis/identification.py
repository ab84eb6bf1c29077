"""Identification from sweeps: joint axes one by one, then DH parameters by their common normals.

`identify_from_axes` takes poses and returns an `AxesIdentification`. Its steps: sweeps are recognised (`sweeps`), each
arc's axis is fitted (`joint_axes`), targets are linked (`target_registration`), the axes are brought to one home
configuration (`home_configuration`) and described (`common_normals`). The covariance is propagated from the poses
through all steps, after the arcs by finite differences.

Where resting joints did not rest exactly, the poses are moved to where they would have been, by the chain just found,
and everything is done once more.

This is the paper's circle point analysis (Boby and Saha 2016, appendix A) with method "cpa"; "screw" uses
the rotations of the same sweeps as well, "combined" the rotations and the encoder's angles.

References: R. A. Boby, S. K. Saha, "Single image based camera calibration and pose estimation of the end-effector of a
robot", ICRA 2016; J. M. Hollerbach, C. W. Wampler, Int. J. Robotics Research 15 (1996) 573-591.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from core.errors import Advisory
from core.geometry import invert, rotation_vectors, transform, transform_mean
from core.kinematics.arm_model import ParameterLayout
from core.kinematics.circle_point_analysis.common_normals import Axes, DhDescription, LinkForm, describe
from core.kinematics.circle_point_analysis.covariance import ArcTree
from core.kinematics.circle_point_analysis.home_configuration import find_home
from core.kinematics.circle_point_analysis.link_types import classify_links
from core.kinematics.circle_point_analysis.target_registration import TargetLink
from core.kinematics.circle_point_analysis.validation import validate_axes
from core.kinematics.dh import JOINT_PARAMETERS, Chain, forward
from core.kinematics.equal_descriptions import height_over_flange
from core.kinematics.global_fit import Unidentifiable, Validation, held_by_axes, unidentifiable
from core.kinematics.joint_angle_checks import check_angles, check_joints
from core.kinematics.joint_axes import AxisFits, fit_axes
from core.kinematics.pose_observations import PoseData
from core.kinematics.results import JointEstimate, validation_warnings
from core.kinematics.sweeps import JOINT_TOLERANCE, Sweep, find_sweeps, require_sweeps

_RESTED = 1e-7  # rad


@dataclass(frozen=True, slots=True)
class AxesIdentification:
    """A robot identified from sweeps.

    Parameters
    ----------
    chain, T_target_base, T_flange_camera
        T_target_camera = T_target_base · forward(chain, q) · T_flange_camera, for each target by its index; the
        tool's rotation is the identity where the poses are positions alone.
    covariance
        (5 j, 5 j) of all parameters (mm, rad), joint by joint in the order of `JOINT_PARAMETERS`; zero where
        `identifiable` is false.
    axes, home
        The joint axes in the first target's frame, at the joint angles `home` (rad).
    scatter_mm, scatter_rad
        Standard deviation of each coordinate of position and rotation beyond the instrument's stated noise.
    forms, height_mm
        How each link but the last is described, and where all axes are parallel the base's height (`describe`).
    residual_mm, residual_rad
        Rms length over the sweeps' poses of measured - predicted by the chain; rotation None for positions alone.
    """

    chain: Chain
    covariance: Float[np.ndarray, "p p"]
    identifiable: Bool[np.ndarray, "j 5"]
    joints: tuple[JointEstimate, ...]
    axes: Axes
    home: Float[np.ndarray, " j"]
    T_target_base: Float[np.ndarray, "t 4 4"]
    T_flange_camera: Float[np.ndarray, "4 4"]
    links: dict[int, TargetLink]
    fits: AxisFits
    scatter_mm: float
    scatter_rad: float | None
    residual_mm: float
    residual_rad: float | None
    null_space: tuple[Unidentifiable, ...]
    forms: tuple[LinkForm, ...]
    height_mm: float
    validation: Validation | None
    warnings: tuple[Advisory, ...]


def identify_from_axes(
    poses: PoseData,
    nominal: Chain | None = None,
    method: str = "combined",
    *,
    sweeps: Sequence[Sweep] | None = None,
    tolerance: float = JOINT_TOLERANCE,
    folds: int = 0,
) -> AxesIdentification:
    """Identify the robot from sweeps of every joint.

    Parameters
    ----------
    nominal
        The robot as its maker describes it: gives the conventions, and selects one of two equivalent descriptions.
    method
        "cpa", "screw" or "combined"; see `core.kinematics.joint_axes.axis_fit.fit_axes`, and there for what
        else is raised.
    sweeps
        The sweeps, if the caller lists them; otherwise they are recognised from the joint angles.
    tolerance
        How far the resting joints of a sweep may differ, rad.
    folds
        Parts that poses are dealt into for validation; 0 for none.

    Raises JointAnglesInconsistent for a nominal of another number of joints, JointNotExcited, JointAnglesUnitMismatch,
    PrismaticJoint, and MotionInsufficient where nothing ties the targets.
    """
    check_joints(poses, nominal)
    found = find_sweeps(poses, tolerance=tolerance) if sweeps is None else tuple(sweeps)
    check_angles(poses, found)
    require_sweeps(found, poses.joints)
    answer = _identify(poses, poses, nominal, method, found, tolerance, None)
    rested = _rested(poses, found, answer)
    if rested is not None:
        answer = _identify(rested, poses, nominal, method, found, tolerance, answer.fits)
    if folds < 2:
        return answer
    validation = validate_axes(
        poses,
        poses if rested is None else rested,
        method,
        answer.fits,
        answer.home,
        answer.forms,
        answer.height_mm,
        answer.chain,
        nominal,
        2.0 * tolerance,
        folds,
    )
    return replace(
        answer, validation=validation, warnings=(*answer.warnings, *validation_warnings(validation))
    )


def _identify(
    poses: PoseData,
    measured: PoseData,
    nominal: Chain | None,
    method: str,
    sweeps: Sequence[Sweep],
    tolerance: float,
    begin: AxisFits | None,
) -> AxesIdentification:
    fits = fit_axes(poses, sweeps, method, begin)
    home = find_home([arc.sweep for arc in fits.arcs], poses.joints, tolerance)
    tree = ArcTree.grown(fits, home, poses, 2.0 * tolerance, measured)
    links, uncertain = tree.links, tree.uncertain(fits)
    axes = uncertain.axes
    forms = classify_links(uncertain, home, nominal)
    described, height = describe(axes, home, forms, nominal), 0.0
    if all(form.parallel for form in forms):
        tool = _placed(measured, fits, described, links)[1]
        height, _ = height_over_flange(described.parameters, tool[:3, 3])
        described = describe(axes, home, forms, nominal, height)

    def parameters(at: Axes) -> Float[np.ndarray, " p"]:
        return describe(at, home, forms, nominal, height).parameters.ravel()

    mask = described.identifiable.ravel()
    covariance = uncertain.propagate_covariance(parameters) * np.outer(mask, mask)
    chain = Chain.from_array(described.parameters)
    T_target_base, T_flange_camera, residual_mm, residual_rad = _placed(measured, fits, described, links)
    return AxesIdentification(
        chain=chain,
        covariance=covariance,
        identifiable=described.identifiable,
        joints=_joints(chain, covariance, described, forms, nominal, sweeps),
        axes=axes,
        home=home,
        T_target_base=T_target_base,
        T_flange_camera=T_flange_camera,
        links=links,
        fits=fits,
        scatter_mm=fits.scatter_mm,
        scatter_rad=fits.scatter_rad,
        residual_mm=residual_mm,
        residual_rad=residual_rad,
        null_space=_null_space(described, forms, poses.rotations is None),
        forms=forms,
        height_mm=height,
        validation=None,
        warnings=fits.warnings,
    )


def _joints(
    chain: Chain,
    covariance: Float[np.ndarray, "p p"],
    described: DhDescription,
    forms: Sequence[LinkForm],
    nominal: Chain | None,
    sweeps: Sequence[Sweep],
) -> tuple[JointEstimate, ...]:
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(-1, 5)
    found = []
    for i, joint in enumerate(chain.joints):
        identifiable = {
            name: bool(t) for name, t in zip(JOINT_PARAMETERS, described.identifiable[i], strict=True)
        }
        uncertainty = {
            name: float(s) if identifiable[name] else None
            for name, s in zip(JOINT_PARAMETERS, sigma[i], strict=True)
        }
        own = [sweep for sweep in sweeps if sweep.joint == i]
        found.append(
            JointEstimate(
                i + 1,
                joint,
                uncertainty,
                identifiable,
                None if nominal is None else nominal.joints[i],
                i < len(forms) and forms[i].parallel,
                max(sweep.arc for sweep in own),
                len({int(pose) for sweep in own for pose in sweep.poses}),
            )
        )
    return tuple(found)


def _null_space(
    described: DhDescription, forms: Sequence[LinkForm], positions_only: bool
) -> tuple[Unidentifiable, ...]:
    """Return what the axes do not determine."""
    parallel = np.array([*(form.parallel for form in forms), False])
    coincident = np.array([*(form.coincident for form in forms), False])
    held = held_by_axes(described.identifiable, parallel, coincident)
    return tuple(unidentifiable(held, ParameterLayout(len(parallel), 1, 0), parallel, positions_only))


def _placed(
    poses: PoseData, fits: AxisFits, described: DhDescription, links: dict[int, TargetLink]
) -> tuple[Float[np.ndarray, "t 4 4"], Float[np.ndarray, "4 4"], float, float | None]:
    """Return the bases, the tool, and what is left of the sweeps' poses."""
    T_target_base = np.tile(np.eye(4), (int(poses.targets.max()) + 1, 1, 1))
    for target, link in links.items():
        T_target_base[target] = invert(link.T_first_target) @ described.T_frame_base
    members = np.unique(np.concatenate([arc.sweep.poses[arc.used] for arc in fits.arcs]))
    seen = poses.take(members)
    T = T_target_base[seen.targets] @ forward(Chain.from_array(described.parameters), seen.joint_angles)
    back = np.linalg.inv(T)
    if seen.rotations is None:
        inside = np.einsum("nij,nj->ni", back[:, :3, :3], seen.positions_mm) + back[:, :3, 3]
        tool = transform(np.eye(3), inside.mean(axis=0))
    else:
        full = np.tile(np.eye(4), (len(seen), 1, 1))
        full[:, :3, :3], full[:, :3, 3] = seen.rotations, seen.positions_mm
        tool = transform_mean(back @ full)
    end = T @ tool
    off = seen.positions_mm - end[:, :3, 3]
    turned = None
    if seen.rotations is not None:
        turns = np.linalg.norm(rotation_vectors(seen.rotations, end[:, :3, :3]), axis=1)
        turned = math.sqrt(float(np.mean(turns**2)))
    return T_target_base, tool, math.sqrt(float(np.mean(np.sum(off**2, axis=1)))), turned


def _rested(poses: PoseData, sweeps: Sequence[Sweep], found: AxesIdentification) -> PoseData | None:
    """Return the poses with all joints but the moving one exactly at rest; None where they were.

    By the chain just found: T' = T_target_base F(q') F(q)⁻¹ T_target_base⁻¹ T. A pose of several sweeps rests at the
    same angles in all of them, within the tolerance; the last sweep counts.
    """
    angles = poses.joint_angles.copy()
    for sweep in sweeps:
        angles[sweep.poses] = sweep.setting
        angles[sweep.poses, sweep.joint] = sweep.angles
    if not np.any(np.abs(angles - poses.joint_angles) > _RESTED):
        return None
    X = found.T_target_base[poses.targets]
    move = (
        X
        @ forward(found.chain, angles)
        @ np.linalg.inv(forward(found.chain, poses.joint_angles))
        @ np.linalg.inv(X)
    )
    positions = np.einsum("nij,nj->ni", move[:, :3, :3], poses.positions_mm) + move[:, :3, 3]
    rotations = None if poses.rotations is None else move[:, :3, :3] @ poses.rotations
    return replace(poses, joint_angles=angles, positions_mm=positions, rotations=rotations)
