"""What a robot has beyond its chain, and how the methods agree, as the API shows them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from core.kinematics import (
    FEW_POSES,
    STRONG_EVIDENCE,
    ErrorModel,
    Level,
    joint_approach,
    joint_compliance,
    joint_curves,
)
from core.session import MethodDifference

_TERMS = {
    Level.DH: (),
    Level.COMPLIANCE: ("compliance",),
    Level.ALL: ("joint_curves", "compliance", "wobble"),
}

_LEVELS = {Level.DH: "dh", Level.COMPLIANCE: "dh_and_compliance", Level.ALL: "all"}


def terms_document(model: ErrorModel, level: Level) -> list[str]:
    """Return the names of a level's terms; `approach` where the side that joints came from is known."""
    return [*_TERMS[level], *(["approach"] if level is Level.ALL and model.knows_approach else [])]


def error_model_document(model: ErrorModel | None) -> dict[str, Any] | None:
    """Return the terms with their uncertainties, in degrees; None where the chain alone is taken."""
    if model is None or model.level is Level.DH:
        return None
    position, rotation = model.scatter.deviations
    turned = len(model.growth) == 2
    return {
        "terms": terms_document(model, model.level),
        "joint_curves": [
            {
                "joint": curve.joint,
                "angles_deg": [math.degrees(angle) for angle in curve.angles.tolist()],
                "correction_deg": [math.degrees(value) for value in curve.correction.tolist()],
                "standard_uncertainty_deg": [
                    math.degrees(value) for value in curve.standard_uncertainty.tolist()
                ],
            }
            for curve in joint_curves(model)
        ],
        "compliance": [
            {
                "joint": one.joint,
                "axis": one.axis,
                "rad_per_m": one.rad_per_m,
                "standard_uncertainty_rad_per_m": one.standard_uncertainty,
            }
            for one in joint_compliance(model)
        ],
        "approach_offsets": [
            {
                "joint": one.joint,
                "offset_deg": math.degrees(one.offset),
                "offset_standard_uncertainty_deg": math.degrees(one.standard_uncertainty),
            }
            for one in joint_approach(model)
        ],
        "noise_mm": position,
        "noise_deg": math.degrees(rotation) if turned else None,
        "held_out_ratio": model.held_out_ratio,
        "blocked_ratio": model.blocked_ratio,
        "position_uncertainty_factor": float(model.growth[0]),
        "rotation_uncertainty_factor": float(model.growth[1]) if turned else None,
    }


def level_document(model: ErrorModel | None) -> dict[str, Any] | None:
    """Return which level was taken, with the evidence, and why in words; None where levels were not compared."""
    if model is None:
        return None
    levels, chain = model.fit.levels, model.fit.levels[Level.DH].minus_2_log
    count = int(model.fit.used.sum())
    gains = {_LEVELS[level]: chain - fitted.minus_2_log for level, fitted in levels.items()}
    return {
        "chosen": _LEVELS[model.level],
        "configurations": count,
        "compliance_evidence": gains["dh_and_compliance"],
        "all_evidence": gains["all"],
        "held_out_ratio": model.held_out_ratio,
        "blocked_ratio": model.blocked_ratio,
        "reason": _reason(_LEVELS[model.level], gains, count),
        "gain": _gain(model),
    }


def _reason(level: str, gains: Mapping[str, float], count: int) -> str:
    name = level.replace("_", " ").replace("dh", "DH")
    compared = f"{gains['dh_and_compliance']:.0f} for compliance, {gains['all']:.0f} for all terms"
    rule = f"over {STRONG_EVIDENCE:g} is needed, and no loss at held-out poses"
    if count < FEW_POSES:
        rule = f"below {FEW_POSES} configurations over {STRONG_EVIDENCE:g} and 5 % less error held out are needed"
    return (
        f"Level: {name}, of {count} configurations; evidence beyond the chain, in twice the log likelihood: {compared} "
        f"({rule})."
    )


def _gain(model: ErrorModel) -> str:
    if model.held_out_ratio is None:
        return "Gain: not known; the poses are too few to hold any out."
    if model.level is Level.DH:
        return "Gain: none; the chain alone predicts held-out poses as well."
    parts = [f"{model.held_out_ratio:.2f} of the chain's error at poses held out at random"]
    if model.blocked_ratio is not None:
        parts.append(f"{model.blocked_ratio:.2f} at held-out blocks of joint space")
    return f"Gain: {', '.join(parts)}."


def method_agreement_document(found: Sequence[MethodDifference]) -> dict[str, Any] | None:
    """Return each method's largest difference from the global fit; None where there is nothing to compare."""
    if not found:
        return None
    known = [one.largest for one in found if one.largest is not None]
    return {
        "largest_difference": max(known, default=None),
        "methods": [
            {
                "method": one.method,
                "largest_difference": one.largest,
                "joint": one.joint,
                "parameter": None if one.parameter is None else _in_api(one.parameter),
                "failure_code": one.failure,
            }
            for one in found
        ],
    }


def _in_api(name: str) -> str:
    return f"{name.removesuffix('_rad')}_deg" if name.endswith("_rad") else name
