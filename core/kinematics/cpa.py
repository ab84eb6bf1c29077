"""Identification from sweeps: joint axes one by one, then DH parameters by their common normals.

`identify_from_axes` is the door: poses in, an `AxesIdentification` out. The steps: sweeps are recognised (`sweeps`),
each arc's axis is fitted (`axes`), targets are linked (`link_targets`), the axes are brought to one home configuration
(`home`) and described (`common_normals`). Covariance is carried from the poses through all of it, by differences of
everything after the arcs.

Where resting joints did not rest exactly, the poses are moved to where they would have been, by the chain just found,
and everything is done once more.

This is the paper's circle point analysis (Boby and Saha 2016, appendix A) with method "cpa"; "screw" and "combined" are
what the same sweeps tell when rotations, and the encoder's angles, are used as well.

References: R. A. Boby, S. K. Saha, "Single image based camera calibration and pose estimation of the end-effector of a
robot", ICRA 2016; J. M. Hollerbach, C. W. Wampler, Int. J. Robotics Research 15 (1996) 573-591.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from core.errors import Advisory, JointAnglesInconsistent
from core.kinematics.angle_units import check_angles
from core.kinematics.axes import AxisFits, fit_axes
from core.kinematics.axes_validation import validate_axes
from core.kinematics.common_normals import Axes, Described, LinkForm, describe
from core.kinematics.dh import JOINT_PARAMETERS, Chain, JointParameters, forward
from core.kinematics.home import common_home
from core.kinematics.link_forms import choose_forms
from core.kinematics.link_targets import Given, TargetLink
from core.kinematics.poses import PoseData
from core.kinematics.remarks import of_validation
from core.kinematics.sweeps import JOINT_TOLERANCE, Sweep, find_sweeps, require_sweeps
from core.kinematics.uncertain_axes import ArcTree
from core.kinematics.validation import Validation
from core.transforms import invert, transform, transform_mean

_RESTED = 1e-7  # rad


@dataclass(frozen=True, slots=True)
class IdentifiedJoint:
    """One joint, counted from 1. The mappings have the names of `JOINT_PARAMETERS`; an uncertainty is None where the
    parameter is not identifiable: it then has the nominal's value, or zero.

    `arc_rad` is the longest sweep's, `poses` how many there are in all its sweeps.
    """

    joint: int
    parameters: JointParameters
    standard_uncertainty: dict[str, float | None]
    identifiable: dict[str, bool]
    nominal: JointParameters | None
    parallel_to_next: bool
    arc_rad: float
    poses: int


@dataclass(frozen=True, slots=True)
class AxesIdentification:
    """What sweeps say of a robot.

    Parameters
    ----------
    chain, T_target_base, T_flange_camera
        T_target_camera = T_target_base · forward(chain, q) · T_flange_camera, for each target by its index; of
        positions alone the tool's rotation is none.
    covariance
        (5 j, 5 j) of all parameters (mm, rad), joint by joint in the order of `JOINT_PARAMETERS`; zero where
        `identifiable` is false.
    axes, home
        The joint axes in the first target's frame, at the joint angles `home` (rad).
    scatter_mm, scatter_rad
        Standard deviation of each coordinate of position and rotation beyond the instrument's stated noise.
    forms
        How each link but the last is described.
    residual_mm, residual_rad
        Rms length over the sweeps' poses of measured - predicted by the chain; rotation None for positions alone.
    """

    chain: Chain
    covariance: Float[np.ndarray, "p p"]
    identifiable: Bool[np.ndarray, "j 5"]
    joints: tuple[IdentifiedJoint, ...]
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
    null_space: tuple[str, ...]
    forms: tuple[LinkForm, ...]
    validation: Validation | None
    warnings: tuple[Advisory, ...]


def identify_from_axes(
    poses: PoseData,
    nominal: Chain | None = None,
    method: str = "combined",
    *,
    sweeps: Sequence[Sweep] | None = None,
    tolerance: float = JOINT_TOLERANCE,
    target_transforms: Given | None = None,
    folds: int = 0,
) -> AxesIdentification:
    """Identify the robot from sweeps of every joint.

    Parameters
    ----------
    nominal
        The robot as its maker describes it: tells conventions and which of two equal descriptions is meant.
    method
        "cpa", "screw" or "combined"; see `core.kinematics.axes.fit_axes`, and there for what else is raised.
    sweeps
        Where they are named; else they are recognised from the joint angles.
    tolerance
        How far the resting joints of a sweep may differ, rad.
    target_transforms
        How targets lie to the first, where that is known; else it is found out.
    folds
        Parts that poses are dealt into for validation; 0 for none.

    Raises JointAnglesInconsistent for a nominal of another number of joints, JointNotMoved, JointAnglesUnit,
    PrismaticJoint, and MotionInsufficient where nothing ties the targets.
    """
    if nominal is not None and len(nominal) != poses.joints:
        raise JointAnglesInconsistent(
            f"The poses carry {poses.joints} joint angles and the robot has {len(nominal)} joints."
        )
    found = find_sweeps(poses, tolerance=tolerance) if sweeps is None else tuple(sweeps)
    check_angles(poses, found)
    require_sweeps(found, poses.joints)
    answer = _identify(poses, poses, nominal, method, found, tolerance, target_transforms, None)
    rested = _rested(poses, found, answer)
    if rested is not None:
        answer = _identify(rested, poses, nominal, method, found, tolerance, target_transforms, answer.fits)
    if folds < 2:
        return answer
    validation = validate_axes(
        poses,
        poses if rested is None else rested,
        method,
        answer.fits,
        answer.home,
        answer.forms,
        answer.chain,
        nominal,
        target_transforms,
        2.0 * tolerance,
        folds,
    )
    return replace(answer, validation=validation, warnings=(*answer.warnings, *of_validation(validation)))


def _identify(
    poses: PoseData,
    measured: PoseData,
    nominal: Chain | None,
    method: str,
    sweeps: Sequence[Sweep],
    tolerance: float,
    given: Given | None,
    begin: AxisFits | None,
) -> AxesIdentification:
    fits = fit_axes(poses, sweeps, method, begin)
    home = common_home([arc.sweep for arc in fits.arcs], poses.joints, tolerance)
    tree = ArcTree.grown(fits, home, poses, given, 2.0 * tolerance, measured)
    links = tree.links
    uncertain = tree.uncertain(fits)
    axes = uncertain.axes
    forms = choose_forms(uncertain, home, nominal)
    described = describe(axes, home, forms, nominal)

    def parameters(at: Axes) -> Float[np.ndarray, " p"]:
        return describe(at, home, forms, nominal).parameters.ravel()

    mask = described.identifiable.ravel()
    covariance = uncertain.carry(parameters) * np.outer(mask, mask)
    chain = Chain.from_array(described.parameters)
    T_target_base, T_flange_camera, residual_mm, residual_rad = _placed(
        measured, fits, chain, described, links
    )
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
        null_space=_null_space(described, forms),
        forms=forms,
        validation=None,
        warnings=fits.warnings,
    )


def _joints(
    chain: Chain,
    covariance: Float[np.ndarray, "p p"],
    described: Described,
    forms: Sequence[LinkForm],
    nominal: Chain | None,
    sweeps: Sequence[Sweep],
) -> tuple[IdentifiedJoint, ...]:
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(-1, 5)
    found = []
    for i, joint in enumerate(chain.joints):
        told = {name: bool(t) for name, t in zip(JOINT_PARAMETERS, described.identifiable[i], strict=True)}
        doubt = {
            name: float(s) if told[name] else None for name, s in zip(JOINT_PARAMETERS, sigma[i], strict=True)
        }
        own = [sweep for sweep in sweeps if sweep.joint == i]
        found.append(
            IdentifiedJoint(
                i + 1,
                joint,
                doubt,
                told,
                None if nominal is None else nominal.joints[i],
                i < len(forms) and forms[i].parallel,
                max(sweep.arc for sweep in own),
                len({int(pose) for sweep in own for pose in sweep.poses}),
            )
        )
    return tuple(found)


def _null_space(described: Described, forms: Sequence[LinkForm]) -> tuple[str, ...]:
    last = len(described.parameters)
    found = [f"theta{last} offset, d{last}, a{last} and alpha{last} cannot be told from the tool transform."]
    if last > 1:
        found.insert(0, "theta1 offset and d1 cannot be told from the base transform.")
    for i, form in enumerate(forms):
        if form.parallel:
            found.append(
                f"Axes {i + 1} and {i + 2} are near parallel: d{i + 1} cannot be told from d{i + 2}; beta{i + 1} is "
                f"identified and d{i + 1} kept."
            )
        if form.coincident and i:
            found.append(
                f"Axes {i + 1} and {i + 2} are one line: theta{i + 1} offset cannot be told from theta{i + 2} offset."
            )
    return tuple(found)


def _placed(
    poses: PoseData, fits: AxisFits, chain: Chain, described: Described, links: dict[int, TargetLink]
) -> tuple[Float[np.ndarray, "t 4 4"], Float[np.ndarray, "4 4"], float, float | None]:
    """Return the bases, the tool, and what is left of the sweeps' poses."""
    T_target_base = np.tile(np.eye(4), (int(poses.targets.max()) + 1, 1, 1))
    for target, link in links.items():
        T_target_base[target] = invert(link.T_first_target) @ described.T_frame_base
    members = np.unique(np.concatenate([arc.sweep.poses[arc.used] for arc in fits.arcs]))
    seen = poses.take(members)
    T = T_target_base[seen.targets] @ forward(chain, seen.joint_angles)
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
        turns = Rotation.from_matrix(seen.rotations @ end[:, :3, :3].swapaxes(1, 2)).magnitude()
        turned = math.sqrt(float(np.mean(turns**2)))
    return T_target_base, tool, math.sqrt(float(np.mean(np.sum(off**2, axis=1)))), turned


def _rested(poses: PoseData, sweeps: Sequence[Sweep], found: AxesIdentification) -> PoseData | None:
    """Return the poses with all joints but the moving one exactly at rest; None where they were.

    By the chain just found: T' = T_target_base F(q') F(q)⁻¹ T_target_base⁻¹ T. A pose of several sweeps rests at the
    same angles in all of them as far as the tolerance tells; the last counts.
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
