"""What a robot has beyond its chain, as files: curves and compliance, and a table of corrected joint angles.

A joint that is commanded to the angle s turns to s + c(s), with c its curve. A controller that takes a table of angles
is given, for each angle that is wanted, the one to command: s + c(s) = wanted.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from app.analyses.documents.robot_files.model_files import Json, Model

CURVE_COLUMNS = ("term", "joint", "name", "axis", "angle_deg", "value", "standard_uncertainty", "unit")
TABLE_COLUMNS = (
    "joint",
    "name",
    "wanted_deg",
    "command_deg",
    "correction_deg",
    "standard_uncertainty_deg",
    "visited",
)
TABLE_STEP_DEG = 1.0
_STEPS = 50
"""Of the fixed point; curves are far flatter than one, so that each step gains digits."""


class NoTerms(Exception):
    """The identified model has none of the terms that a file holds."""


def write_terms_json(model: Model) -> str:
    """Return level, curves, compliance, offsets by approach and region as JSON, as the service answers them."""
    document = model.document
    kept = ("session_id", "inputs_sha256", "core_version", "source", "estimator", "level", "region")
    terms = _terms(model)
    named = {
        "robot": model.name,
        **{name: document[name] for name in kept},
        "joint_coupling": document["joint_coupling"],
        "joint_names": list(model.joint_names),
        "joint_curves": terms["joint_curves"],
        "compliance": terms["compliance"],
        "approach_offsets": terms.get("approach_offsets", []),  # reports of earlier versions have none
    }
    return json.dumps(named, indent=2, ensure_ascii=False) + "\n"


def write_terms_csv(model: Model) -> str:
    """Return a row for each angle of each curve (degrees), for each compliance (rad per metre of lever) and for
    each joint's offset by approach (degrees, after a move to a larger angle).
    """
    terms = _terms(model)
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(CURVE_COLUMNS)
    for curve in terms["joint_curves"]:
        name = model.joint_names[curve["joint"] - 1]
        for angle, value, u in _points(curve):
            rows.writerow(("joint_curve", curve["joint"], name, "z", angle, value, u, "deg"))
    for one in terms["compliance"]:
        name = model.joint_names[one["joint"] - 1]
        value, u = one["rad_per_m"], one["standard_uncertainty_rad_per_m"]
        rows.writerow(("compliance", one["joint"], name, one["axis"], None, value, u, "rad/m"))
    for one in terms.get("approach_offsets", []):
        name = model.joint_names[one["joint"] - 1]
        value, u = one["offset_deg"], one["offset_standard_uncertainty_deg"]
        rows.writerow(("approach", one["joint"], name, "z", None, value, u, "deg"))
    return text.getvalue()


def write_angle_table(model: Model) -> str:
    """Return, in steps of 1° within the angles that each joint visited, the angle to command for each that is wanted.

    Raises NoTerms for a model without joint curves.
    """
    curves = _terms(model)["joint_curves"]
    if not curves:
        raise NoTerms("The identified model has no joint curves, so that there are no angles to correct.")
    regions = {joint["joint"]: joint["gaps"] for joint in model.document["region"]["joints"]}
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(TABLE_COLUMNS)
    for curve in curves:
        name, gaps = model.joint_names[curve["joint"] - 1], regions.get(curve["joint"], [])
        angles = np.array(curve["angles_deg"])
        wanted = np.arange(math.ceil(angles[0]), math.floor(angles[-1]) + 0.5, TABLE_STEP_DEG)
        commands = angles_to_command(wanted, angles, np.array(curve["correction_deg"]))
        u = np.interp(commands, angles, curve["standard_uncertainty_deg"])
        for angle, command, uncertainty in zip(wanted.tolist(), commands.tolist(), u.tolist(), strict=True):
            visited = not any(gap["minimum_deg"] < angle < gap["maximum_deg"] for gap in gaps)
            correction = command - angle
            rows.writerow(
                (
                    curve["joint"],
                    name,
                    f"{angle:.0f}",
                    f"{command:.5f}",
                    f"{correction:.5f}",
                    f"{uncertainty:.5f}",
                    "yes" if visited else "no",
                )
            )
    return text.getvalue()


def angles_to_command(
    wanted_deg: Float[np.ndarray, " w"],
    angles_deg: Float[np.ndarray, " a"],
    correction_deg: Float[np.ndarray, " a"],
) -> Float[np.ndarray, " w"]:
    """Return the commands s with s + c(s) = wanted, c linear between the curve's angles; all in degrees."""
    command = wanted_deg.astype(np.float64)
    for _ in range(_STEPS):
        command = wanted_deg - np.interp(command, angles_deg, correction_deg)
    return command


def _terms(model: Model) -> Json:
    terms: Json | None = model.document["error_model"]
    if terms is None:
        level = model.document["level"]
        raise NoTerms(
            "The identified model has no terms beyond the chain." + (f" {level['reason']}" if level else "")
        )
    return terms


def _points(curve: Json) -> Iterator[tuple[float, float, float]]:
    return zip(curve["angles_deg"], curve["correction_deg"], curve["standard_uncertainty_deg"], strict=True)
