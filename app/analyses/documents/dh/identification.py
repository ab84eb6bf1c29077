"""A robot's Denavit-Hartenberg parameters as the API shows them: degrees, named fields, null where not determined."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, astuple
from typing import Any

import numpy as np

from app.analyses.documents.dh.error_model import (
    error_model_document,
    level_document,
    method_agreement_document,
)
from app.analyses.documents.encoding import mounted_frames, refined_estimate, target_transform_document
from app.analyses.documents.findings import Findings
from app.analyses.documents.sweep_names import parsed, sweeps_named
from app.records.numbers import DH_PARAMETERS
from core.geometry import invert
from core.kinematics import (
    JOINT_PARAMETERS,
    Blocking,
    HoldOutError,
    JointEstimate,
    JointParameters,
    JointRegion,
    ModelChoice,
    Unidentifiable,
    Validation,
)
from core.session import (
    CameraMount,
    NamedSweep,
    RobotIdentification,
    SessionData,
    identify_robot,
    with_nominal_orientations,
)

TRIALS, LEAST_TRIALS, MAX_DRAWN_POSES = 200, 100, 150_000
"""Of the sampling: 200 trials give a standard deviation to 5 %, 100 to 7 %; a drawn pose takes about 0.1 ms."""
API_NAMES = dict(zip(JOINT_PARAMETERS, DH_PARAMETERS, strict=True))


def dh_findings(data: SessionData, settings: Mapping[str, str]) -> Findings:
    """Return what `GET .../dh` answers."""
    data, found = identified(data, settings)
    fields = {
        "estimator": settings["estimator"],
        "method": settings["method"],
        "model": settings["model"],
        "source": settings["source"],
        "convention": "classic_dh",
        "joint_coupling": None if data.joint_coupling is None else data.joint_coupling.tolist(),
        "joint_tolerance_deg": float(settings["joint_tolerance_deg"]),
        "named_sweeps": list(sweeps_named(settings.get("sweeps", "[]"))),
        **_robot(found, data),
    }
    return Findings(fields, found.excluded, found.warnings)


def identified(data: SessionData, settings: Mapping[str, str]) -> tuple[SessionData, RobotIdentification]:
    """Identify the robot by these settings; return it with the session as it was read."""
    estimate = None
    if settings["source"] == "images":
        data = with_nominal_orientations(data)
        estimate = refined_estimate(data, settings)
    names = sweeps_named(settings.get("sweeps", "[]"))
    found = identify_robot(
        data,
        estimate,
        method=settings["method"],
        model=ModelChoice(settings["model"]),
        tolerance=math.radians(float(settings["joint_tolerance_deg"])),
        sweeps=[NamedSweep(joint, tuple(pose_ids)) for joint, pose_ids in map(parsed, names)],
        trials=_trials(data) if settings.get("uncertainty") == "monte_carlo" else 0,
    )
    return data, found


def _robot(found: RobotIdentification, data: SessionData) -> dict[str, Any]:
    condition = found.conditioning.condition_number
    return {
        "joints": [
            {
                **joint_document(joint.estimate),
                "poses": joint.poses,
                "residual": held_out_document(joint.residual) if joint.residual is not None else None,
            }
            for joint in found.joints
        ],
        "residual": held_out_document(found.residual),
        "chain_residual": held_out_document(found.chain_residual) if found.chain_residual else None,
        "validation": _validation(found.validation),
        "level": level_document(found.error_model),
        "error_model": error_model_document(found.error_model),
        "region": {"joints": [region_document(joint) for joint in found.region]},
        "method_agreement": method_agreement_document(found.method_agreement),
        "condition_number": condition if math.isfinite(condition) else None,
        "observability_o1": found.conditioning.observability_o1,
        "observability_indices": asdict(found.conditioning.indices),
        "null_space": null_space_document(found.null_space, _mount(found, data)),
        "parameters": [_key(key, _mount(found, data)) for key in found.parameters],
        "correlation": np.clip(found.correlation, -1.0, 1.0).tolist(),
        "parameter_sampling": _sampling_document(found, _mount(found, data)),
        "robot_scatter": {
            "position_sigma_mm": found.scatter_mm,
            "rotation_sigma_deg": None if found.scatter_rad is None else math.degrees(found.scatter_rad),
        },
        **mounted_frames(
            (found.T_flange_camera, found.flange_camera_covariance),
            [
                ({"target_id": target_id}, invert(T), covariance)
                for target_id, T, covariance in zip(
                    _target_ids(found, data), found.T_target_base, found.base_target_covariances, strict=True
                )
            ],
            _mount(found, data),
        ),
        "target_transforms": [
            target_transform_document(transform, data, found.targets) for transform in found.target_transforms
        ],
    }


def _trials(data: SessionData) -> int:
    """Return how many trials the session's poses leave time for."""
    poses = max(len(data.measured) or len(data.images), 1)
    return min(max(MAX_DRAWN_POSES // poses, LEAST_TRIALS), TRIALS)


def _sampling_document(found: RobotIdentification, mount: CameraMount) -> dict[str, Any] | None:
    """Return the parameters by sampling next to what is stated; None unless asked for."""
    sampling = found.sampling
    if sampling is None:
        return None
    rows = zip(
        found.parameters,
        sampling.ratio.tolist(),
        sampling.shift.tolist(),
        sampling.agrees.tolist(),
        strict=True,
    )
    return {
        "trials": sampling.trials,
        "joint_ratio": sampling.joint_ratio,
        "ratio_tolerance": sampling.ratio_tolerance,
        "shift_tolerance": sampling.shift_tolerance,
        "agrees": bool(sampling.agrees.all()),
        "sampled_parameters": [
            {"parameter": _key(key, mount), "uncertainty_ratio": ratio, "mean_shift": shift, "agrees": agrees}
            for key, ratio, shift, agrees in rows
        ],
    }


def null_space_document(
    groups: Iterable[Unidentifiable], mount: CameraMount = "robot"
) -> list[dict[str, Any]]:
    """Return groups of parameters that are not identifiable, by their keys and with a sentence each."""
    return [
        {"parameters": [_key(key, mount) for key in group.parameters], "sentence": group.sentence}
        for group in groups
    ]


def _mount(found: RobotIdentification, data: SessionData) -> CameraMount:
    """Return what the camera that measured the poses is on; another instrument's probe is on the robot."""
    return data.camera_mount if found.targets else "robot"


def _key(key: str, mount: CameraMount) -> str:
    """Return a parameter's key with the API's unit and the frame's name."""
    if mount == "fixed":
        key = key.replace("flange_camera", "flange_target").replace("target_base", "camera_base")
    return f"{key.removesuffix('_rad')}_deg" if key.endswith("_rad") else key


def _target_ids(found: RobotIdentification, data: SessionData) -> list[str | None]:
    """Return the id of each target; that of another instrument's frame is None."""
    return [data.target_ids[place] for place in found.targets] or [None] * len(found.T_target_base)


def joint_document(joint: JointEstimate) -> dict[str, Any]:
    """Return one joint's parameters and standard uncertainties, in mm and degrees; null where undetermined."""
    values = _parameters(joint.parameters)
    if not joint.parallel_to_next and joint.parameters.beta_rad == 0.0:
        values["beta_deg"] = None
    nominal = None if joint.nominal is None else _parameters(joint.nominal)
    if joint.nominal is not None and nominal is not None and joint.nominal.beta_rad == 0.0:
        nominal["beta_deg"] = None
    return {
        "joint": joint.joint,
        **values,
        "parallel_to_next": joint.parallel_to_next,
        "standard_uncertainty": {
            API_NAMES[name]: None if value is None else _in_degrees(name, value)
            for name, value in joint.standard_uncertainty.items()
        },
        "nominal": nominal,
        "identifiable": {API_NAMES[name]: determined for name, determined in joint.identifiable.items()},
        "arc_deg": math.degrees(joint.arc_rad),
    }


def _parameters(joint: JointParameters) -> dict[str, float | None]:
    values = dict(zip(API_NAMES, astuple(joint), strict=True))
    return {API_NAMES[name]: _in_degrees(name, value) for name, value in values.items()}


def _in_degrees(name: str, value: float) -> float:
    return math.degrees(value) if name.endswith("_rad") else value


def region_document(joint: JointRegion) -> dict[str, Any]:
    """Return where a joint has been, in degrees."""
    return {
        "joint": joint.joint,
        "minimum_deg": math.degrees(joint.minimum),
        "maximum_deg": math.degrees(joint.maximum),
        "gaps": [
            {"minimum_deg": math.degrees(low), "maximum_deg": math.degrees(high)} for low, high in joint.gaps
        ],
    }


def _validation(found: Validation | None) -> dict[str, Any] | None:
    if found is None:
        return None
    by_clusters = [block for block in found.blocks if block.blocking is Blocking.CLUSTERS]
    return {
        **held_out_document(found.identified),
        "held_out_poses": found.held_out,
        "outlier_poses": found.excluded,
        "random": held_out_document(found.identified),
        "blocked": held_out_document(by_clusters[0].identified) if by_clusters else None,
        "nominal": _nominal(found.nominal),
        "blocks": [
            {
                "blocking": str(block.blocking),
                "block_count": block.blocks,
                **held_out_document(block.identified),
                "nominal": _nominal(block.nominal),
            }
            for block in found.blocks
        ],
    }


def _nominal(errors: HoldOutError | None) -> dict[str, Any] | None:
    return None if errors is None else held_out_document(errors)


def held_out_document(errors: HoldOutError) -> dict[str, Any]:
    """Return rms errors, of rotations in degrees."""
    return {
        "position_rms_mm": errors.position_rms_mm,
        "rotation_rms_deg": None if errors.rotation_rms is None else math.degrees(errors.rotation_rms),
    }
