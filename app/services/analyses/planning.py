"""What poses would tell of a robot, before anyone moves it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from app.services.analyses.kinematics_documents import joint_document
from app.services.analyses.kinematics_poses import nominal_chain
from app.services.analyses.outcome import CannotAnalyse
from core import Camera, TargetSpec
from core.camera import CAMERA_PARAMETERS
from core.kinematics.dh import Chain
from core.kinematics.planning import Prediction, Rig, predict, rig_before, suggest
from core.simulation.arm import sweep_angles

POSES_AT_MOST = 2000
POINTS_AT_MOST = 2_000_000
"""Grid points of all poses and candidates of one plan, which takes about 1.3 kB for each."""
_SEED = 9283  # free poses and candidates are a matter of chance, the same at every request
_ROUNDING = 1e-9  # rad
_JOINT_FIELDS = ("joint", "parallel_to_next", "standard_uncertainty", "identifiable")


def plan_document(
    robot: list[dict[str, Any]], target: Mapping[str, Any], request: Mapping[str, Any]
) -> dict[str, Any]:
    """Return what `POST .../dh-plan` answers, but for the ids; `request` is its body."""
    chain = nominal_chain(robot)
    assert chain is not None
    rng = np.random.default_rng(_SEED)
    limits = _limits(robot)
    q = _angles(chain, limits, request, rng)
    _check_limits(q, limits)
    rig = _rig(chain, target, request)
    _check_size(len(q), target, request)
    try:
        return _document(chain, limits, q, rig, rng, request)
    except np.linalg.LinAlgError:
        raise CannotAnalyse(
            "degenerate_geometry",
            "These poses say so little of robot or lens that nothing can be predicted.",
            "Move more joints, further, and tilt the camera against the grid; check the camera's figures.",
        ) from None


def _check_size(poses: int, target: Mapping[str, Any], request: Mapping[str, Any]) -> None:
    looked_at = poses + (request["candidates"] if request["suggest"] else 0)
    points = looked_at * target["columns"] * target["rows"]
    if points > POINTS_AT_MOST:
        raise CannotAnalyse(
            "plan_too_large",
            f"The plan looks at {points} grid points in {looked_at} poses and candidates; one takes {POINTS_AT_MOST}.",
            "Plan with fewer poses or candidates, or with a coarser grid.",
        )


def _document(
    chain: Chain,
    limits: Float[np.ndarray, "2 j"],
    q: Float[np.ndarray, "n j"],
    rig: Rig,
    rng: np.random.Generator,
    request: Mapping[str, Any],
) -> dict[str, Any]:
    planned = predict(chain, q, rig)
    suggested = np.zeros((0, len(chain)))
    with_suggested = None
    if request["suggest"]:
        candidates = _drawn(rng, request, request["candidates"], limits)
        suggested = candidates[suggest(chain, q[planned.visible], candidates, rig, request["suggest"])]
        if len(suggested):
            with_suggested = _joints(predict(chain, np.concatenate([q, suggested]), rig))
    condition = planned.conditioning.condition_number
    return {
        "poses": [
            {"joint_angles_deg": angles, "visible": bool(seen)}
            for angles, seen in zip(np.degrees(q).tolist(), planned.visible, strict=True)
        ],
        "joints": _joints(planned),
        "condition_number": condition if math.isfinite(condition) else None,
        "observability_o1": planned.conditioning.observability_o1,
        "null_space": list(planned.null_space),
        "suggested": np.degrees(suggested).tolist(),
        "joints_with_suggested": with_suggested,
    }


def _joints(planned: Prediction) -> list[dict[str, Any]]:
    return [
        {name: value for name, value in joint_document(joint, 0).items() if name in _JOINT_FIELDS}
        for joint in planned.joints
    ]


def _home(request: Mapping[str, Any]) -> Float[np.ndarray, " j"]:
    return np.radians(np.array(request["home_deg"], dtype=np.float64))


def _limits(robot: list[dict[str, Any]]) -> Float[np.ndarray, "2 j"]:
    """Return the least and the largest angle of every joint, rad; infinite where the robot states none."""
    names = (("lower_deg", -math.inf), ("upper_deg", math.inf))
    return np.radians(np.array([[joint.get(name, free) for joint in robot] for name, free in names]))


def _check_limits(q: Float[np.ndarray, "n j"], limits: Float[np.ndarray, "2 j"]) -> None:
    """Raise CannotAnalyse where a pose is beyond what the robot's joints can do."""
    beyond = (q < limits[0] - _ROUNDING) | (q > limits[1] + _ROUNDING)
    if beyond.any():
        joint = int(np.argmax(beyond.any(axis=0)))
        low, high = np.degrees(limits[:, joint])
        least, largest = np.degrees([q[:, joint].min(), q[:, joint].max()])
        raise CannotAnalyse(
            "joint_limits_exceeded",
            f"{int(beyond.any(axis=1).sum())} of {len(q)} poses are beyond the robot's joint limits: joint {joint + 1} "
            f"is to turn from {least:.6g}° to {largest:.6g}°, and may from {low:.6g}° to {high:.6g}°.",
            "Move home, shorten half_arc_deg, or take those poses out; free and suggested poses stay within limits.",
        )


def _drawn(
    rng: np.random.Generator, request: Mapping[str, Any], count: int, limits: Float[np.ndarray, "2 j"]
) -> Float[np.ndarray, "n j"]:
    """Return angles at random about home, all joints at once, as far as the limits let them."""
    home, half_range = _home(request), math.radians(request["half_range_deg"])
    low, high = np.maximum(home - half_range, limits[0]), np.minimum(home + half_range, limits[1])
    return np.asarray(rng.uniform(low, np.maximum(low, high), (count, len(home))))


def _angles(
    chain: Chain, limits: Float[np.ndarray, "2 j"], request: Mapping[str, Any], rng: np.random.Generator
) -> Float[np.ndarray, "n j"]:
    """Return all poses that are thought of, rad: sweeps, free ones, those one by one."""
    home = _home(request)
    listed = request["joint_angles_deg"]
    sweeps = request["sweeps"]
    joints = sweeps["joints"] if sweeps is not None else None
    if any(len(angles) != len(chain) for angles in (request["home_deg"], *listed)) or any(
        joint > len(chain) for joint in joints or ()
    ):
        raise CannotAnalyse(
            "joint_angles_inconsistent",
            f"The robot has {len(chain)} joints; home or a pose has another number, or a sweep names another joint.",
            "Give one angle for each of the robot's joints, in their order from the base.",
        )
    _check_limits(home[None], limits)
    parts = [np.zeros((0, len(chain)))]
    if sweeps is not None:
        parts.append(
            sweep_angles(
                home,
                half_arc=math.radians(sweeps["half_arc_deg"]),
                steps=sweeps["steps"],
                joints=None if joints is None else [joint - 1 for joint in joints],
            )
        )
    if request["free_poses"]:
        parts.append(_drawn(rng, request, request["free_poses"], limits))
    if listed:
        parts.append(np.radians(np.array(listed, dtype=np.float64)))
    q = np.concatenate(parts)
    if not 0 < len(q) <= POSES_AT_MOST:
        raise CannotAnalyse(
            "too_few_poses" if not len(q) else "too_many_poses",
            f"The plan has {len(q)} poses; one to {POSES_AT_MOST} can be judged.",
            "Give sweeps, free_poses or joint_angles_deg.",
        )
    return q


def _rig(chain: Chain, target: Mapping[str, Any], request: Mapping[str, Any]) -> Rig:
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
            raise CannotAnalyse(
                "invalid_matrix",
                "T_flange_camera is no rigid transform.",
                "Write a rotation and a translation (mm) over a last row 0 0 0 1.",
            )
    return rig_before(
        chain,
        _home(request),
        Camera(**{name: camera[name] for name in CAMERA_PARAMETERS}),
        (camera["image_width_px"], camera["image_height_px"]),
        TargetSpec(**target),
        T_flange_camera,
        noise_px=request["noise_px"],
        fill=request["fill"],
        scatter_position_mm=request["robot_position_mm"],
        scatter_rotation=math.radians(request["robot_rotation_deg"]),
    )
