"""The robot's page of a session: parameters in words, and which differences from the data sheet can be claimed.

A warning weakens the table where it says something that the stated uncertainties do not contain.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from app.records.numbers import DH_PARAMETERS
from app.web.words import NONE, fixed, plain, with_uncertainty

WEAKENING = {
    "no_better_than_nominal": "Poses held out in turn are met no better than with the data sheet's parameters.",
    "deviation_from_nominal_large": "A parameter is farther from the data sheet than robots are built: angles count in "
    "another sense or from another zero than the data sheet says, or it has a wrong value.",
    "print_scale_mismatch": "All long lengths are off by one factor: the print has another pitch than stated, and the "
    "parameters are off with it.",
    "instrument_scale_mismatch": "All long lengths are off by one factor: so is the instrument's scale, or the data "
    "sheet is another model's.",
    "frame_moved": "The instrument, the target or the robot's base moved while the poses were measured.",
    "joint_coupling_proposed": "The joints seem to be coupled, and the robot states no coupling: the angles are not "
    "those of its axes.",
    "residuals_large": "The poses are farther off the identified arm than robots scatter: something is wrong with "
    "them.",
    "terms_beyond_chain": "Gears and compliance show in the poses, and the uncertainties of this method do not allow "
    "for them.",
}
"""Warnings that concern every parameter, and why: what the poses are compared with, or the model, does not hold.

Others leave the claims of the table as they are. `ill_conditioned` and `joints_move_together` say that combinations of
parameters are known less accurately than others: their uncertainties state by how much. `methods_disagree` is a matter
of the methods that use sweeps, `poses_excluded` and `approach_matters` one of single poses. `short_arc` concerns the
parameters next to the axes that it names (`weak_joints`).
"""
UNCONFIRMED = "The poses are too few to hold some out, so that nothing confirms the parameters."
SHORT_ARCS = "No joint turned far: gears that err over so short an arc look like axes that stand elsewhere."
MAX_RATIO_BY_CHANCE = 3.0
MIN_ARC_DEG = 20.0
"""Below which `short_arc` is given."""
PARAMETER_NAMES = dict(zip(DH_PARAMETERS, "aαdθβ", strict=True))


def objections(document: dict[str, Any]) -> list[str]:
    """Return why no difference from the data sheet can be claimed, in sentences; none where it can."""
    found = [] if document["validation"] is not None else [UNCONFIRMED]
    codes = {one["code"] for one in document["warnings"]}
    found += [sentence for code, sentence in WEAKENING.items() if code in codes]
    if len(weak_joints(document)) == len(document["joints"]):
        found.append(SHORT_ARCS)
    return found


def weak_joints(document: dict[str, Any]) -> list[int]:
    """Return the joints whose parameters a short arc makes uncertain: before and after an axis that hardly turned.

    The axis of joint i lies between the links i - 1 and i. Errors of its gear over a short arc are in no uncertainty.
    """
    short = {joint["joint"] for joint in document["joints"] if joint["arc_deg"] < MIN_ARC_DEG}
    return [one["joint"] for one in document["joints"] if {one["joint"], one["joint"] + 1} & short]


def joint_rows(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return each joint's parameters in words: nominal, identified with uncertainty, and their difference.

    A parameter `stands_out` where it differs from the nominal, and the identification is one to go by.
    """
    weak = set(weak_joints(document))
    sure = not objections(document)
    return [
        _row(joint, name, sure and joint["joint"] not in weak)
        for joint in document["joints"]
        for name in _stated(joint)
    ]


def _stated(joint: dict[str, Any]) -> Iterator[str]:
    return (name for name in DH_PARAMETERS if joint[name] is not None)


def _row(joint: dict[str, Any], name: str, sure: bool) -> dict[str, Any]:
    value = joint[name]
    nominal = (joint["nominal"] or {}).get(name)
    identifiable = joint["identifiable"][name]
    uncertainty = joint["standard_uncertainty"][name]
    difference = None if nominal is None or not identifiable else value - nominal
    ratio = abs(difference) / uncertainty if difference is not None and uncertainty else None
    if identifiable:
        identified = with_uncertainty(value, uncertainty)
    elif nominal is not None and math.isclose(value, nominal, abs_tol=1e-9):
        identified = "as the data sheet"
    else:
        identified = f"{plain(value)} (held)"
    return {
        "joint": joint["joint"],
        "name": PARAMETER_NAMES[name],
        "unit": "mm" if name.endswith("_mm") else "°",
        "nominal": plain(nominal),
        "identified": identified,
        "difference": NONE if difference is None else with_uncertainty(difference, uncertainty),
        "ratio": NONE if ratio is None else fixed(ratio, 1),
        "stands_out": sure and ratio is not None and ratio > MAX_RATIO_BY_CHANCE,
        "identifiable": identifiable,
    }
