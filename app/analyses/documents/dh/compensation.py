"""Corrected commands as the API shows them: degrees, stated joint angles, the flange in the robot's base."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from app.analyses.documents.dh.correctable import partial_correction
from app.analyses.documents.dh.error_model import terms_document
from app.analyses.documents.dh.identification import held_out_document, region_document
from app.analyses.documents.encoding import refined_estimate
from app.analyses.documents.findings import Findings
from app.analyses.outcome import AnalysisError
from core import Advisory
from core.errors import listed
from core.geometry import rotation_to_rpy, rpy_to_rotation, transform
from core.kinematics import (
    Chain,
    Corrected,
    CorrectionErrors,
    Level,
    Outcome,
    correct,
    forward,
    solve_inverse,
)
from core.session import SessionCorrection, SessionData, session_correction, with_nominal_orientations

MAX_DIFFERENCE_MM, MAX_DIFFERENCE_DEG = 0.1, 0.02
"""Between a command's pose and the nominal robot's at its joint angles: beyond, base or angles are others."""
_ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")
_UNREACHABLE = "not_reachable"


def compensation_findings(
    data: SessionData, second: SessionData | None, settings: Mapping[str, str]
) -> Findings:
    """Return what `POST .../compensate` answers."""
    commands = json.loads(settings["poses"])
    chain = data.nominal
    assert chain is not None
    _check(commands, len(chain))
    estimate = None
    if settings["source"] == "images":
        data = with_nominal_orientations(data)
        estimate = refined_estimate(data, settings)
        second = None if second is None else with_nominal_orientations(second)
    asked = settings["curves"] == "true"
    found = session_correction(data, estimate, curves=asked, second=second)
    _require_gain(found)
    q, known, warnings = _configurations(commands, data, found)
    limits = np.radians(np.array(json.loads(settings["limits"]), dtype=np.float64).T)
    corrected = correct(found.by, q, limits, data.joint_coupling)
    documents = _documents(commands, q, known, data, corrected)
    fields = {
        "robot_id": settings["robot_id"],
        "estimator": settings["estimator"],
        "source": settings["source"],
        "terms": terms_document(found.by.model, found.by.level),
        "curves": {
            "applied": found.curves_applied,
            "basis": _basis(found, second, asked=asked),
            "confirming_ratio": found.confirming_ratio,
            "failure_code": found.confirming_failure,
        },
        "validation": {"random_gain": _gain(found.by.random), "blocked_gain": _gain(found.by.blocked)},
        "region": {"joints": [region_document(joint) for joint in found.by.region]},
        "poses": documents,
    }
    of_commands = (*_of_outcomes(documents, found), *partial_correction(corrected, known))
    return Findings(fields, found.found.excluded, (*found.found.warnings, *warnings, *of_commands))


def _check(commands: Sequence[Mapping[str, Any]], joints: int) -> None:
    """Refuse commands that state neither all joint angles nor a whole pose, naming the first."""
    for place, command in enumerate(commands):
        angles = command["joint_angles_deg"]
        pose = (command["position_mm"], *(command[name] for name in _ANGLES))
        if angles is not None and len(angles) != joints:
            raise AnalysisError(
                "joint_angles_inconsistent",
                f"Pose {command['pose_id']} (number {place + 1}) has {len(angles)} joint angles; the robot has "
                f"{joints} joints.",
                "Give one angle for each joint, or leave joint_angles_deg away and give the whole pose.",
            )
        if angles is None and any(part is None for part in pose):
            raise AnalysisError(
                "command_incomplete",
                f"Pose {command['pose_id']} (number {place + 1}) states neither joint angles nor a whole pose.",
                "Give joint_angles_deg, or position_mm with roll_deg, pitch_deg and yaw_deg.",
            )


def _require_gain(found: SessionCorrection) -> None:
    ratio = found.by.random.position_ratio
    if ratio is not None and ratio >= 1.0:
        raise AnalysisError(
            "correction_not_supported",
            f"At held-out poses corrected commands would be off {ratio:.2f} times as far as uncorrected ones.",
            "Add poses over the whole range of the commands; thirty that move all joints are a beginning, sixty are "
            "sound.",
        )


def _configurations(
    commands: Sequence[Mapping[str, Any]], data: SessionData, found: SessionCorrection
) -> tuple[Float[np.ndarray, "n j"], list[bool], list[Advisory]]:
    """Return the model's joint angles of all commands (rad), and which are known."""
    chain = found.by.nominal.chain
    q, known = np.zeros((len(commands), len(chain))), [True] * len(commands)
    poses = {i: _pose(command) for i, command in enumerate(commands)}
    by_pose = [i for i, command in enumerate(commands) if command["joint_angles_deg"] is None]
    by_angles = [i for i in range(len(commands)) if i not in set(by_pose)]
    warnings = []
    if by_angles:
        stated = np.array([commands[i]["joint_angles_deg"] for i in by_angles], dtype=np.float64)
        q[by_angles] = data.model_angles(stated)
        warnings += _differing(commands, by_angles, poses, chain, q)
    if by_pose:
        measured = found.by.model.fit.design.seen.joint_angles
        inverse = solve_inverse(chain, np.array([poses[i] for i in by_pose]), measured)
        q[by_pose] = inverse.joint_angles
        for i, attained in zip(by_pose, inverse.attained.tolist(), strict=True):
            known[i] = attained
        warnings.append(
            Advisory(
                "configuration_assumed",
                f"{len(by_pose)} commands state no joint angles: the configuration nearest to measured ones is taken.",
                "Send joint_angles_deg with the commands; a correction holds for one configuration of the arm.",
            )
        )
    return q, known, warnings


def _pose(command: Mapping[str, Any]) -> Float[np.ndarray, "4 4"] | None:
    angles = [command[name] for name in _ANGLES]
    if command["position_mm"] is None or any(angle is None for angle in angles):
        return None
    return transform(rpy_to_rotation(np.radians(angles)), np.array(command["position_mm"], dtype=np.float64))


def _differing(
    commands: Sequence[Mapping[str, Any]],
    by_angles: Sequence[int],
    poses: Mapping[int, Float[np.ndarray, "4 4"] | None],
    chain: Chain,
    q: Float[np.ndarray, "n j"],
) -> list[Advisory]:
    """Name the commands whose pose is not the nominal robot's at their joint angles."""
    at, far = forward(chain, q[by_angles]), []
    for T, i in zip(at, by_angles, strict=True):
        stated = poses[i]
        if stated is None:
            continue
        off = float(np.linalg.norm(stated[:3, 3] - T[:3, 3]))
        cosine = (float(np.trace(stated[:3, :3].T @ T[:3, :3])) - 1.0) / 2.0
        turn = math.degrees(math.acos(min(1.0, max(-1.0, cosine))))
        if off > MAX_DIFFERENCE_MM or turn > MAX_DIFFERENCE_DEG:
            far.append(str(commands[i]["pose_id"]))
    if not far:
        return []
    return [
        Advisory(
            "command_inconsistent",
            f"The poses of {listed(far)} are not those of the nominal robot at their joint angles; the angles are "
            "taken, and corrected poses are the nominal robot's, in its own base and without a tool.",
            "Check base, tool and zeros of the controller against the robot's nominal parameters.",
        )
    ]


def _documents(
    commands: Sequence[Mapping[str, Any]],
    q: Float[np.ndarray, "n j"],
    known: Sequence[bool],
    data: SessionData,
    corrected: Corrected,
) -> list[dict[str, Any]]:
    C = np.eye(q.shape[1]) if data.joint_coupling is None else data.joint_coupling
    stated = np.degrees(corrected.joint_angles @ np.linalg.inv(C).T)
    documents = []
    for i, command in enumerate(commands):
        outcome = str(corrected.outcomes[i]) if known[i] else _UNREACHABLE
        applied = known[i] and corrected.outcomes[i].applied
        rotations = len(corrected.expected) == 2
        pose = dict(command)
        if applied:
            T = corrected.T_base_flange[i]
            angles = np.degrees(rotation_to_rpy(T[:3, :3])).tolist()
            pose |= {
                "position_mm": T[:3, 3].tolist(),
                **dict(zip(_ANGLES, angles, strict=True)),
                "joint_angles_deg": stated[i].tolist(),
            }
        documents.append(
            pose
            | {
                "outcome": outcome,
                "applied": applied,
                "uncorrected_error_mm": float(corrected.shift[0, i]) if known[i] else None,
                "uncorrected_error_deg": math.degrees(corrected.shift[1, i]) if known[i] else None,
                "expected_residual_mm": float(corrected.expected[0, i]) if applied else None,
                "expected_residual_deg": (
                    math.degrees(corrected.expected[1, i]) if applied and rotations else None
                ),
            }
        )
    return documents


def _of_outcomes(documents: Sequence[Mapping[str, Any]], found: SessionCorrection) -> list[Advisory]:
    """Return a warning for commands that are not corrected, one for those corrected with less certainty."""
    warnings = []
    left = [str(one["pose_id"]) for one in documents if not one["applied"]]
    if left:
        warnings.append(
            Advisory(
                "commands_not_corrected",
                f"{len(left)} of {len(documents)} commands are left as they were: {listed(left)}. `outcome` says why.",
                "Measure poses over the whole range of the commands: corrections do not reach beyond it.",
            )
        )
    less = {
        Outcome.IN_GAP: "a joint lies in a gap",
        Outcome.NEAR_SINGULARITY: "the arm is near a singularity",
    }
    for outcome, why in less.items():
        of = [str(one["pose_id"]) for one in documents if one["outcome"] == outcome]
        if of:
            warnings.append(
                Advisory(
                    f"command_{outcome}", f"Corrected with less certainty, because {why}: {listed(of)}.", None
                )
            )
    if found.by.random.corrected is None:
        warnings.append(
            Advisory(
                "correction_not_validated",
                "The session has too few poses to hold any out: what the correction gains is not known.",
                "Add poses; sixty that move all joints are sound.",
            )
        )
    return warnings


def _basis(found: SessionCorrection, second: SessionData | None, *, asked: bool) -> str:
    model = found.found.error_model
    if model is None or model.level is not Level.ALL:
        return "not_supported"
    if asked:
        return "requested"
    if second is None:
        return "no_second_session"
    return "confirmed" if found.curves_applied else "not_confirmed"


def _gain(errors: CorrectionErrors) -> dict[str, Any]:
    return {
        "with_correction": None if errors.corrected is None else held_out_document(errors.corrected),
        "nominal": None if errors.nominal is None else held_out_document(errors.nominal),
        "position_ratio": errors.position_ratio,
    }
