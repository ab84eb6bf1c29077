"""Sections of a kinematics report: parameters with uncertainties, identifiability, validation, frames."""

from __future__ import annotations

from typing import Any

from app.records.numbers import DH_PARAMETERS
from app.reports.forms.blocks import (
    NORMAL_95,
    UNKNOWN,
    Block,
    excluded_of,
    facts,
    heading,
    notes,
    number,
    paragraph,
    table,
    warnings_of,
)
from app.reports.forms.wording import Json, symbols, words

ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")


def kinematics_blocks(found: Json, inputs: Json) -> list[Block]:
    """Return the sections; `found` is the analysis `dh`."""
    return [
        *_result(found),
        *_parameters(found),
        *_identifiability(found),
        *_validation(found),
        *frame_blocks(found),
        *excluded_of(found, inputs),
        *warnings_of(found),
    ]


def _result(found: Json) -> list[Block]:
    validation, residual = found["validation"], found["residual"]
    measured = "images" if found.get("source", "images") == "images" else "readings"
    rows: list[tuple[str, Any]] = [
        ("method", words(found["method"])),
        ("model", words(found["model"])),
        ("convention", words(found["convention"])),
        ("residual", _errors(residual)),
    ]
    if validation is not None:
        rows.append(("held out", f"{_errors(validation)}, {validation['held_out_poses']} {measured}"))
        if validation["nominal"] is not None:
            rows.append(("the nominal model on the same", _errors(validation["nominal"])))
    level = found.get("level")
    return [heading("Result"), facts(rows), *notes([level["reason"], level["gain"]] if level else [])]


def _errors(one: Json) -> str:
    parts = [f"{number(one['position_rms_mm'])} mm rms"]
    if one.get("rotation_rms_deg") is not None:
        parts.append(f"{number(one['rotation_rms_deg'])}° rms")
    return ", ".join(parts)


def _parameters(found: Json) -> list[Block]:
    blocks: list[Block] = [heading("Denavit-Hartenberg parameters")]
    rows = []
    for joint in found["joints"]:
        for name in DH_PARAMETERS:
            value, u = joint[name], joint["standard_uncertainty"][name]
            if value is None:
                continue
            nominal = (joint["nominal"] or {}).get(name)
            rows.append(
                [
                    str(joint["joint"]),
                    _symbol(name),
                    "yes" if joint["identifiable"].get(name) else "no",
                    number(value, u),
                    number(u, u) if u is not None else UNKNOWN,
                    f"{number(value - NORMAL_95 * u, u)} … {number(value + NORMAL_95 * u, u)}"
                    if u
                    else UNKNOWN,
                    number(nominal),
                    number(value - nominal, u) if nominal is not None else UNKNOWN,
                ]
            )
    columns = ("joint", "parameter", "identifiable", "value", "u", "95 % interval", "nominal", "deviation")
    blocks += table("Parameters joint by joint; u: standard uncertainty", columns, rows, text_columns=3)
    rows = [
        [
            str(joint["joint"]),
            number(joint["arc_deg"], places=1),
            str(joint["poses"]) if joint["poses"] is not None else UNKNOWN,
        ]
        for joint in found["joints"]
    ]
    blocks += table("Motion of each joint", ("joint", "arc, °", "poses"), rows)
    return blocks


def _symbol(name: str) -> str:
    letters = {"a_mm": "a, mm", "alpha_deg": "α, °", "d_mm": "d, mm", "theta_offset_deg": "θ₀, °"}
    return letters.get(name, "β, °")


def _identifiability(found: Json) -> list[Block]:
    sentences = [
        symbols(one["sentence"]) for one in found.get("unidentifiable") or found.get("null_space") or ()
    ]
    if not sentences:
        return [heading("Identifiability"), paragraph("The poses determine every parameter of the model.")]
    return [
        heading("Identifiability"),
        paragraph(
            "The poses do not determine these separately. Parameters of joints that are not identifiable stand at the "
            "nominal robot's values, at zero without one; what is held of a frame has no uncertainty:"
        ),
        *notes(sentences),
    ]


def _validation(found: Json) -> list[Block]:
    one = found["validation"]
    if one is None:
        return [heading("Validation"), paragraph("Too few poses to hold any out.")]
    rows = []
    for name, errors in (
        ("random folds", one["random"]),
        ("blocks", one["blocked"]),
        ("nominal model", one["nominal"]),
    ):
        if errors is not None:
            rows.append([name, number(errors["position_rms_mm"]), number(errors.get("rotation_rms_deg"))])
    blocks = [
        heading("Validation"),
        *table("Errors of poses that were held out", ("folds", "position, mm rms", "rotation, ° rms"), rows),
    ]
    agreement = found["method_agreement"]
    if agreement is not None and agreement.get("largest_difference") is not None:
        blocks.append(
            facts(
                [
                    (
                        "largest difference between methods",
                        f"{number(agreement['largest_difference'], places=2)} u",
                    )
                ]
            )
        )
    model = found["error_model"]
    if model is not None and model.get("terms"):
        blocks.append(facts([("terms beyond the chain", ", ".join(map(words, model["terms"])))]))
    return blocks


def frame_blocks(found: Json) -> list[Block]:
    """Return where camera or probe and targets are, each with its uncertainty where that is known."""
    blocks: list[Block] = []
    camera = found["flange_camera"]
    instrument = "Camera" if found["source"] == "images" else "Probe"
    if camera is not None:
        blocks += _transform(f"{instrument} in the flange's frame", camera, "T_flange_camera")
    if found.get("base_camera") is not None:
        blocks += _transform("Fixed camera in the base frame", found["base_camera"], "T_base_camera")
    for one in found.get("flange_targets") or ():
        blocks += _transform(f"Target {one['named']} in the flange's frame", one, "T_flange_target")
    for one in found["base_targets"] or ():
        name = f"Target {one['named']}" if one["target_id"] else "The instrument's frame"
        blocks += _transform(f"{name} in the base frame", one, "T_base_target")
    return [heading("Frames"), *blocks] if blocks else []


def _transform(caption: str, one: Json, name: str) -> list[Block]:
    matrix = one[name]
    u = one.get("standard_uncertainty") or dict.fromkeys(("x_mm", "y_mm", "z_mm", *ANGLES))
    rows = [
        [
            axis,
            *(number(value, places=6) for value in row[:3]),
            number(row[3], u[f"{axis}_mm"], places=3),
            number(u[f"{axis}_mm"], u[f"{axis}_mm"]),
        ]
        for axis, row in zip("xyz", matrix, strict=False)
    ]
    blocks = table(
        f"{caption}: rotation, and position in mm with its standard uncertainty",
        ("row", "x", "y", "z", "position", "u"),
        rows,
    )
    angles = [
        f"{number(one[name], u[name])}° (u {number(u[name], u[name])}°)"
        for name in ANGLES
        if u[name] is not None and one.get(name) is not None
    ]
    return [*blocks, facts([("roll, pitch, yaw", ", ".join(angles))])] if angles else blocks
