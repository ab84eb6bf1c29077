"""What was found of a robot, as the API shows it: degrees, named fields, null where there is no doubt to tell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from app.services.analyses.snapshot import Snapshot
from core.kinematics.cpa import AxesIdentification, IdentifiedJoint
from core.kinematics.dh import JointParameters
from core.kinematics.identifiability import Conditioning, conditioning
from core.kinematics.identification import Identification
from core.kinematics.joint_estimates import JointEstimate
from core.kinematics.parameters import ArmState, Layout
from core.kinematics.poses import PoseData
from core.kinematics.problem import linearised, observations_of
from core.kinematics.sweeps import Sweep
from core.kinematics.target_transforms import TargetTransform
from core.kinematics.validation import HeldOut, Validation, rms

API_NAMES = {
    "a_mm": "a_mm",
    "alpha_rad": "alpha_deg",
    "d_mm": "d_mm",
    "theta_offset_rad": "theta_offset_deg",
    "beta_rad": "beta_deg",
}


def axes_document(
    found: AxesIdentification, poses: PoseData, snapshot: Snapshot, targets: Sequence[int]
) -> dict[str, Any]:
    """Return the fields of what sweeps alone tell; `poses` are those it was found from."""
    free = np.flatnonzero(found.identifiable.ravel())
    covariance = found.covariance[np.ix_(free, free)]
    unit = 1.0 / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    how = _conditioning(found, poses)
    return {
        "joints": [
            {**joint_document(joint, joint.poses), "residual": _arc_residual(found, joint.joint - 1)}
            for joint in found.joints
        ],
        "residual": _held_out(HeldOut(found.residual_mm, found.residual_rad)),
        "validation": _validation(found.validation),
        "condition_number": how.condition_number if math.isfinite(how.condition_number) else None,
        "observability_o1": how.observability_o1,
        "null_space": list(found.null_space),
        "parameters": [Layout(len(found.joints), 1, 0).names()[column] for column in free],
        "correlation": np.clip(covariance * np.outer(unit, unit), -1.0, 1.0).tolist(),
        "robot_scatter": {
            "position_mm": found.scatter_mm,
            "rotation_deg": None if found.scatter_rad is None else math.degrees(found.scatter_rad),
        },
        "T_flange_camera": found.T_flange_camera.tolist(),
        "T_target_base": [T.tolist() for T in found.T_target_base],
        "target_transforms": [
            {
                "from_target_id": snapshot.target_ids[targets[min(found.links)]],
                "to_target_id": snapshot.target_ids[targets[target]],
                "T_from_to": link.T_first_target.tolist(),
                "covariance": _told(link.covariance),
                "images": link.pairs,
            }
            for target, link in sorted(found.links.items())
            if target != min(found.links)
        ],
    }


def _told(covariance: Float[np.ndarray, "6 6"] | None) -> list[list[float]]:
    assert covariance is not None  # an identification has carried it from the arcs
    return covariance.tolist()


def _conditioning(found: AxesIdentification, poses: PoseData) -> Conditioning:
    """Return how well the sweeps' poses tell the parameters, at the chain that was found."""
    members = np.unique(np.concatenate([arc.sweep.poses[arc.used] for arc in found.fits.arcs]))
    seen = observations_of(poses.take(members))
    arm = ArmState(
        found.chain.as_array(),
        found.T_flange_camera,
        found.T_target_base[: seen.layout.targets],
        np.zeros(seen.layout.shared),
    )
    free = np.ones(arm.layout.size, dtype=np.bool_)
    free[: arm.layout.tool.start] = found.identifiable.ravel()
    _, J = linearised(arm, seen)
    return conditioning(arm, J, free, np.ones(len(seen), dtype=np.bool_))


def _arc_residual(found: AxesIdentification, joint: int) -> dict[str, Any]:
    """Return how far the poses of a joint's sweeps lie off its axis' motion."""
    off = np.concatenate([arc.residuals[arc.used] for arc in found.fits.arcs if arc.sweep.joint == joint])
    return _held_out(rms(np.ascontiguousarray(off.T)))


def identification_document(
    found: Identification, snapshot: Snapshot, targets: Sequence[int]
) -> dict[str, Any]:
    """Return an identification's fields, the joints' arcs and poses as of all poses that count."""
    condition = found.conditioning.condition_number
    return {
        "joints": [joint_document(joint, int(found.used.sum())) for joint in found.joints],
        "residual": _held_out(found.residual),
        "validation": _validation(found.validation),
        "condition_number": condition if math.isfinite(condition) else None,
        "observability_o1": found.conditioning.observability_o1,
        "null_space": list(found.null_space),
        "parameters": list(found.names),
        "correlation": np.clip(found.correlation, -1.0, 1.0).tolist(),
        "robot_scatter": {
            "position_mm": found.scatter_position_mm,
            "rotation_deg": None if found.scatter_rotation is None else math.degrees(found.scatter_rotation),
        },
        "T_flange_camera": found.T_flange_camera.tolist(),
        "T_target_base": [T.tolist() for T in found.T_target_base],
        "target_transforms": [transform_document(t, snapshot, targets) for t in found.target_transforms],
    }


def joint_document(joint: JointEstimate | IdentifiedJoint, poses: int) -> dict[str, Any]:
    """Return one joint's parameters with their doubt; degrees, and nulls where there is none."""
    values = _parameters(joint.parameters)
    if not joint.parallel_to_next:
        values["beta_deg"] = None
    nominal = None
    if joint.nominal is not None:
        nominal = {name: value for name, value in _parameters(joint.nominal).items() if name != "beta_deg"}
    return {
        "joint": joint.joint,
        **values,
        "parallel_to_next": joint.parallel_to_next,
        "standard_uncertainty": {
            API_NAMES[name]: None if value is None else _in_degrees(name, value)
            for name, value in joint.standard_uncertainty.items()
        },
        "nominal": nominal,
        "identifiable": {API_NAMES[name]: told for name, told in joint.identifiable.items()},
        "arc_deg": math.degrees(joint.arc_rad),
        "poses": poses,
        "residual": None,
    }


def transform_document(found: TargetTransform, snapshot: Snapshot, targets: Sequence[int]) -> dict[str, Any]:
    """Return how two targets lie to one another, by the targets' ids."""
    return {
        "from_target_id": snapshot.target_ids[targets[found.from_target]],
        "to_target_id": snapshot.target_ids[targets[found.to_target]],
        "T_from_to": found.T_from_to.tolist(),
        "covariance": found.covariance.tolist(),
        "images": found.poses,
    }


def add_residuals(
    joints: list[dict[str, Any]],
    found: Identification,
    images: Int[np.ndarray, " m"],
    sweeps: Sequence[Sweep],
) -> None:
    """Add to every joint the residuals at the poses where it alone moved, where there are such."""
    place = {int(pose): i for i, pose in enumerate(images)}
    for document in joints:
        members = {int(p) for s in sweeps if s.joint == document["joint"] - 1 for p in s.poses}
        rows = [place[p] for p in sorted(members) if p in place and found.used[place[p]]]
        if rows:
            document["residual"] = _held_out(rms(found.residuals[:, rows]))


def _parameters(joint: JointParameters) -> dict[str, float | None]:
    values = dict(zip(API_NAMES, astuple(joint), strict=True))
    return {API_NAMES[name]: _in_degrees(name, value) for name, value in values.items()}


def _in_degrees(name: str, value: float) -> float:
    return math.degrees(value) if name.endswith("_rad") else value


def _validation(found: Validation | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        **_held_out(found.identified),
        "held_out": found.held_out,
        "left_out": found.left_out,
        "nominal": _held_out(found.nominal) if found.nominal is not None else None,
    }


def _held_out(errors: HeldOut) -> dict[str, Any]:
    return {
        "position_rms_mm": errors.position_rms_mm,
        "rotation_rms_deg": None if errors.rotation_rms is None else math.degrees(errors.rotation_rms),
    }
