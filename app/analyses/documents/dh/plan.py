"""Plan of an identification: which parameters given poses would determine, and which further poses to add."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from app.analyses.documents.dh.identification import joint_document, null_space_document
from app.analyses.inputs.session_loader import nominal_chain
from app.analyses.outcome import AnalysisError
from core import Camera, TargetSpec
from core.geometry import CAMERA_PARAMETERS
from core.kinematics import CameraSetup, Chain, Prediction, default_setup, predict, suggest_poses
from core.simulation import sweep_angles

MAX_POSES = 2000
MAX_POINTS = 2_000_000
"""Grid points of all poses and candidates of one plan, which takes about 1.3 kB for each."""
_SEED = 9283  # free poses and candidates are a matter of chance, the same at every request
_ROUNDING = 1e-9  # rad
_JOINT_FIELDS = ("joint", "parallel_to_next", "standard_uncertainty", "identifiable")


@dataclass(frozen=True, slots=True)
class _Robot:
    """A robot as its maker describes it. `limits` are of the stated joint angles, rad; the chain's angles are
    `coupling` times those.
    """

    chain: Chain
    coupling: Float[np.ndarray, "j j"]
    limits: Float[np.ndarray, "2 j"]

    def of_chain(self, stated: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n j"]:
        return stated @ self.coupling.T

    def stated(self, of_chain: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n j"]:
        return np.linalg.solve(self.coupling, of_chain.T).T


def plan_document(
    robot: Mapping[str, Any], target: Mapping[str, Any], request: Mapping[str, Any]
) -> dict[str, Any]:
    """Return what `POST .../dh-plan` answers, but for the ids; `request` is its body.

    `robot` has the `joints` and their `joint_coupling`.
    """
    described = _described(robot)
    rng = np.random.default_rng(_SEED)
    q = _angles(described, request, rng)
    _check_limits(q, described.limits)
    rig = _rig(described, target, request)
    looked_at = len(q) + (request["candidate_count"] if request["suggest_count"] else 0)
    check_plan_size(looked_at, target["columns"], target["rows"])
    try:
        return _document(described, q, rig, rng, request)
    except np.linalg.LinAlgError:
        raise AnalysisError(
            "degenerate_geometry",
            "These poses say so little of robot or lens that nothing can be predicted.",
            "Move more joints, further, and tilt the camera against the grid; check the camera's figures.",
        ) from None


def check_plan_size(looked_at: int, columns: int, rows: int) -> None:
    """Raise AnalysisError `plan_too_large` where so many looks at a grid take more memory than an analysis has."""
    points = looked_at * columns * rows
    if points > MAX_POINTS:
        raise AnalysisError(
            "plan_too_large",
            f"The plan looks at {points} grid points in {looked_at} poses and candidates; one takes {MAX_POINTS}.",
            "Plan with fewer poses or candidates, or with a coarser grid.",
        )


def _described(robot: Mapping[str, Any]) -> _Robot:
    chain = nominal_chain(robot["joints"])
    assert chain is not None
    coupling = robot["joint_coupling"]
    C = np.eye(len(chain)) if coupling is None else np.array(coupling, dtype=np.float64)
    return _Robot(chain, C, _limits(robot["joints"]))


def _document(
    robot: _Robot,
    q: Float[np.ndarray, "n j"],
    rig: CameraSetup,
    rng: np.random.Generator,
    request: Mapping[str, Any],
) -> dict[str, Any]:
    """Judge poses at the stated angles `q`, rad."""
    chain, of_chain = robot.chain, robot.of_chain(q)
    planned = predict(chain, of_chain, rig)
    suggested = np.zeros((0, len(chain)))
    with_suggested: Prediction | None = None
    if request["suggest_count"]:
        candidates = _drawn(rng, request, request["candidate_count"], robot.limits)
        best = suggest_poses(
            chain, of_chain[planned.visible], robot.of_chain(candidates), rig, request["suggest_count"]
        )
        suggested = candidates[best]
        if len(suggested):
            with_suggested = predict(chain, robot.of_chain(np.concatenate([q, suggested])), rig)
    condition = planned.conditioning.condition_number
    return {
        "poses": [
            {"joint_angles_deg": angles, "shows_target": bool(seen)}
            for angles, seen in zip(np.degrees(q).tolist(), planned.visible, strict=True)
        ],
        "joints": _joints(planned),
        "condition_number": condition if math.isfinite(condition) else None,
        "observability_o1": planned.conditioning.observability_o1,
        "observability_indices": asdict(planned.conditioning.indices),
        "null_space": null_space_document(planned.null_space),
        "suggested_poses": [{"joint_angles_deg": q} for q in np.degrees(suggested).tolist()],
        "predicted_joints_with_suggestions": None if with_suggested is None else _joints(with_suggested),
        "observability_indices_with_suggestions": None
        if with_suggested is None
        else asdict(with_suggested.conditioning.indices),
    }


def _joints(planned: Prediction) -> list[dict[str, Any]]:
    return [
        {name: value for name, value in joint_document(joint).items() if name in _JOINT_FIELDS}
        for joint in planned.joints
    ]


def _home(request: Mapping[str, Any]) -> Float[np.ndarray, " j"]:
    return np.radians(np.array(request["home_deg"], dtype=np.float64))


def _limits(joints: list[dict[str, Any]]) -> Float[np.ndarray, "2 j"]:
    """Return the least and the largest angle of every joint, rad; infinite where the robot states none."""
    names = (("minimum_deg", -math.inf), ("maximum_deg", math.inf))
    return np.radians(np.array([[joint.get(name, free) for joint in joints] for name, free in names]))


def _check_limits(q: Float[np.ndarray, "n j"], limits: Float[np.ndarray, "2 j"]) -> None:
    """Raise AnalysisError if a pose is beyond the limits of the robot's joints."""
    beyond = (q < limits[0] - _ROUNDING) | (q > limits[1] + _ROUNDING)
    if beyond.any():
        joint = int(np.argmax(beyond.any(axis=0)))
        low, high = np.degrees(limits[:, joint])
        least, largest = np.degrees([q[:, joint].min(), q[:, joint].max()])
        raise AnalysisError(
            "joint_limits_exceeded",
            f"{int(beyond.any(axis=1).sum())} of {len(q)} poses are beyond the robot's joint limits: joint {joint + 1} "
            f"is to turn from {least:.6g}° to {largest:.6g}°, and may from {low:.6g}° to {high:.6g}°.",
            "Move home, shorten sweep_half_angle_deg, or remove those poses; random and suggested ones stay "
            "within limits.",
        )


def _drawn(
    rng: np.random.Generator, request: Mapping[str, Any], count: int, limits: Float[np.ndarray, "2 j"]
) -> Float[np.ndarray, "n j"]:
    """Return stated angles at random about home, all joints at once, as far as the limits let them."""
    home, half_range = _home(request), math.radians(request["random_half_range_deg"])
    low, high = np.maximum(home - half_range, limits[0]), np.minimum(home + half_range, limits[1])
    return np.asarray(rng.uniform(low, np.maximum(low, high), (count, len(home))))


def _angles(robot: _Robot, request: Mapping[str, Any], rng: np.random.Generator) -> Float[np.ndarray, "n j"]:
    """Return the stated angles of all poses that are thought of, rad: sweeps, free ones, those one by one.

    A sweep turns one joint of the chain; where joints are coupled, it moves several stated angles.
    """
    chain, limits, home = robot.chain, robot.limits, _home(request)
    listed = [pose["joint_angles_deg"] for pose in request["poses"]]
    sweeps = request["sweeps"]
    joints = sweeps["joint_numbers"] if sweeps is not None else None
    if any(len(angles) != len(chain) for angles in (request["home_deg"], *listed)) or any(
        joint > len(chain) for joint in joints or ()
    ):
        raise AnalysisError(
            "joint_angles_inconsistent",
            f"The robot has {len(chain)} joints; home or a pose has another number, or a sweep names another joint.",
            "Give one angle for each of the robot's joints, in their order from the base.",
        )
    _check_limits(home[None], limits)
    parts = [np.zeros((0, len(chain)))]
    if sweeps is not None:
        of_chain = sweep_angles(
            robot.of_chain(home[None])[0],
            half_arc=math.radians(sweeps["sweep_half_angle_deg"]),
            steps=sweeps["steps"],
            joints=None if joints is None else [joint - 1 for joint in joints],
        )
        parts.append(robot.stated(of_chain))
    if request["random_poses"]:
        parts.append(_drawn(rng, request, request["random_poses"], limits))
    if listed:
        parts.append(np.radians(np.array(listed, dtype=np.float64)))
    q = np.concatenate(parts)
    if not 0 < len(q) <= MAX_POSES:
        raise AnalysisError(
            "too_few_poses" if not len(q) else "too_many_poses",
            f"The plan has {len(q)} poses; one to {MAX_POSES} can be judged.",
            "Give sweeps, random_poses or poses.",
        )
    return q


def _rig(robot: _Robot, target: Mapping[str, Any], request: Mapping[str, Any]) -> CameraSetup:
    camera = request["camera"]
    T_flange_camera = np.eye(4)
    if request["T_flange_camera"] is not None:
        T_flange_camera = np.array(request["T_flange_camera"], dtype=np.float64)
        R = T_flange_camera[:3, :3]
        if (
            np.abs(R @ R.T - np.eye(3)).max() > 1e-5
            or np.linalg.det(R) < 0.0
            or np.any(T_flange_camera[3] != [0.0, 0.0, 0.0, 1.0])
        ):
            raise AnalysisError(
                "invalid_matrix",
                "T_flange_camera is no rigid transform.",
                "Write a rotation and a translation (mm) over a last row 0 0 0 1.",
            )
    return default_setup(
        robot.chain,
        robot.of_chain(_home(request)[None])[0],
        Camera(**{name: camera[name] for name in CAMERA_PARAMETERS}),
        (camera["image_width_px"], camera["image_height_px"]),
        TargetSpec(**target),
        T_flange_camera,
        noise_px=request["noise_px"],
        fill=request["image_coverage"],
        scatter_position_mm=request["robot_position_sigma_mm"],
        scatter_rotation=math.radians(request["robot_rotation_sigma_deg"]),
    )
