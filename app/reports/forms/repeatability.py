"""Sections of a repeatability report, in the order of ISO 9283: conditions, poses, RP, AP, AD, RD, vAP, drift."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from app.reports.forms.blocks import (
    UNKNOWN,
    Block,
    excluded_of,
    facts,
    heading,
    notes,
    number,
    paragraph,
    table,
    vector,
    warnings_of,
    with_interval,
    words,
)
from app.reports.forms.cycles import drift_blocks, outlier_blocks, steadiness_blocks
from app.reports.forms.uncertainty_budget import budget_blocks

Json = Mapping[str, Any]
_ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")
RP_AXES = ("rp_x_mm", "rp_y_mm", "rp_z_mm", "rp_roll_deg", "rp_pitch_deg", "rp_yaw_deg")
AP_AXES = ("ap_x_mm", "ap_y_mm", "ap_z_mm", "ap_roll_deg", "ap_pitch_deg", "ap_yaw_deg")
VERDICTS = {
    "robot": "The reading is the robot's.",
    "instrument_limited": "The instrument's noise contributes to the reading.",
    "below_detection": "The reading is less than the instrument's noise alone would give.",
    "not_steady": "The cycles are not independent and identically distributed.",
    "too_few_cycles": "Too few cycles for a figure.",
}


def repeatability_blocks(found: Json, inputs: Json) -> list[Block]:
    """Return the sections; `found` is the analysis, `inputs` what it was computed from."""
    level = f"{100.0 * found['confidence_level']:g} %"
    return [
        *_result(found, level),
        *_instrument(found),
        *_poses(found, inputs),
        *_repeatability(found, level),
        *_accuracy(found, level),
        *_distances(found, level),
        *_approaches(found),
        *drift_blocks(found),
        *steadiness_blocks(found),
        *budget_blocks(found),
        *outlier_blocks(found),
        *excluded_of(found, inputs),
        *warnings_of(found),
    ]


def headline(found: Json) -> list[Block]:
    """Return the table of RP alone, for a report on the whole session."""
    return _rp_table(found, f"{100.0 * found['confidence_level']:g} %")


def _result(found: Json, level: str) -> list[Block]:
    known = [pose for pose in found["poses"] if pose["repeatability"]["rp_l_mm"] is not None]
    blocks = [heading("Result")]
    if known:
        worst = max(known, key=lambda pose: pose["repeatability"]["rp_l_mm"])
        value, interval = with_interval(worst["repeatability"]["rp_l_mm"], worst["interval"]["rp_l_mm"])
        rows = [
            ("largest RP_l", f"{value} mm at pose {worst['pose_id']}, {level} interval {interval} mm"),
            ("its noise floor", f"{number(worst['noise_floor']['rp_l_mm'])} mm"),
            ("its verdict", f"{words(worst['verdict'])}. {VERDICTS[worst['verdict']]}"),
        ]
        accurate = [pose for pose in known if pose["accuracy"] and pose["accuracy"]["ap_p_mm"] is not None]
        if accurate:
            worst = max(accurate, key=lambda pose: pose["accuracy"]["ap_p_mm"])
            value, interval = with_interval(
                worst["accuracy"]["ap_p_mm"], worst["accuracy"]["interval"]["ap_p_mm"]
            )
            rows.append(
                ("largest AP_p", f"{value} mm at pose {worst['pose_id']}, {level} interval {interval} mm")
            )
        blocks.append(facts(rows))
    else:
        blocks.append(paragraph("No pose has two cycles that count: no figure is known."))
    for name, limit, figure in (
        ("acceptance", "datasheet_repeatability_mm", "RP_l"),
        ("accuracy_acceptance", "datasheet_accuracy_mm", "AP_p"),
    ):
        one = found[name]
        if one is not None:
            blocks.append(
                facts(
                    [
                        (
                            f"{figure} against the data sheet",
                            f"{one['decision'].upper()}: limit {one[limit]:g} mm",
                        ),
                        ("rule", one["rule"]),
                        ("reason", one["reason"]),
                    ]
                )
            )
    return blocks


def _instrument(found: Json) -> list[Block]:
    """Return what was measured with: the camera that all images of a focus group give, and how."""
    rows = [
        [
            group["focus_group"],
            words(group["lens_model"]),
            str(group["image_count"]),
            number(group["intrinsics"]["fx_px"], group["standard_uncertainty"]["fx_px"]),
            number(group["standard_uncertainty"]["fx_px"], group["standard_uncertainty"]["fx_px"]),
            number(group["reduced_chi2"], places=3),
        ]
        for group in found["groups"]
    ]
    columns = ("focus group", "lens model", "images", "focal length, px", "u, px", "reduced χ²")
    caption = f"Camera, from the images of the session itself; estimator: {words(found['estimator'])}"
    found_blocks = table(caption, columns, rows, text_columns=2)
    return [heading("Measuring instrument"), *found_blocks] if found_blocks else []


def _poses(found: Json, inputs: Json) -> list[Block]:
    commanded = {pose["pose_id"]: pose for pose in inputs["poses"]}
    stated = [
        [
            pose_id,
            *vector(pose["position_mm"]),
            *(number(pose[name], places=3) for name in _ANGLES),
            pose["approach"] or UNKNOWN,
        ]
        for pose_id, pose in commanded.items()
        if pose["position_mm"] is not None or pose["approach"] is not None
    ]
    joints = [
        [pose_id, "  ".join(number(angle, places=3) for angle in pose["joint_angles_deg"])]
        for pose_id, pose in commanded.items()
        if pose["joint_angles_deg"] is not None
    ]
    attained = [
        [
            pose["pose_id"],
            str(pose["cycles"]),
            *vector(pose["mean"]["position_mm"]),
            *(number(pose["mean"][name], places=4) for name in _ANGLES),
        ]
        for pose in found["poses"]
    ]
    axes = ("x, mm", "y, mm", "z, mm", "roll, °", "pitch, °", "yaw, °")
    frame = "camera in the target frame" if found["source"] == "images" else "probe in the instrument's frame"
    return [
        heading("Poses"),
        *table(
            "Commanded poses in the robot's base frame, with the direction of approach",
            ("pose", *axes, "approach"),
            stated,
        ),
        *table("Commanded joint angles, degrees", ("pose", "joints 1 …"), joints, text_columns=2),
        *table(f"Mean attained poses: {frame}", ("pose", "cycles", *axes), attained),
    ]


def _rp_table(found: Json, level: str) -> list[Block]:
    rows = []
    for pose in found["poses"]:
        value, interval = with_interval(pose["repeatability"]["rp_l_mm"], pose["interval"]["rp_l_mm"])
        corrected, corrected_interval = with_interval(
            pose["corrected"]["rp_l_mm"], pose["corrected_interval"]["rp_l_mm"]
        )
        rows.append(
            [
                pose["pose_id"],
                words(pose["verdict"]),
                str(pose["cycles"]),
                value,
                interval,
                number(pose["noise_floor"]["rp_l_mm"]),
                corrected,
                corrected_interval,
            ]
        )
    columns = ("pose", "verdict", "n", "RP_l", f"{level} interval", "floor", "corrected", f"{level} interval")
    caption = "Positioning repeatability RP_l, mm (7.2.2), over all cycles; floor: what the noise alone gives"
    return table(caption, columns, rows, text_columns=2)


def _repeatability(found: Json, level: str) -> list[Block]:
    by_axis = [
        [
            pose["pose_id"],
            *(with_interval(pose["repeatability"][n], pose["interval"][n])[0] for n in RP_AXES),
        ]
        for pose in found["poses"]
    ]
    intervals = [
        [
            pose["pose_id"],
            *(with_interval(pose["repeatability"][n], pose["interval"][n])[1] for n in RP_AXES),
        ]
        for pose in found["poses"]
    ]
    axes = ("x, mm", "y, mm", "z, mm", "roll, °", "pitch, °", "yaw, °")
    return [
        heading("Pose repeatability RP (ISO 9283:1998, 7.2.2)"),
        *_rp_table(found, level),
        *notes([f"{words(code)}: {text}" for code, text in VERDICTS.items() if code in _codes(found)]),
        *table("RP along the axes: 3 S", ("pose", *axes), by_axis),
        *table(f"{level} intervals of RP along the axes", ("pose", *axes), intervals),
    ]


def _codes(found: Json) -> set[str]:
    return {pose["verdict"] for pose in found["poses"]}


def _accuracy(found: Json, level: str) -> list[Block]:
    rows, axes_rows = [], []
    for pose in found["poses"]:
        one = pose["accuracy"]
        if one is None:
            continue
        value, interval = with_interval(one["ap_p_mm"], one["interval"]["ap_p_mm"])
        rows.append([pose["pose_id"], value, interval, number(one["held_out"]["ap_p_mm"])])
        axes_rows.append(
            [pose["pose_id"], *(with_interval(one[name], one["interval"][name])[0] for name in AP_AXES)]
        )
    if not rows:
        return [
            heading("Pose accuracy AP (7.2.1)"),
            paragraph("Not determined: no commanded poses tie the robot's base to the measuring frame."),
        ]
    axes = ("x, mm", "y, mm", "z, mm", "roll, °", "pitch, °", "yaw, °")
    return [
        heading("Pose accuracy AP (7.2.1)"),
        paragraph(
            "Attained less commanded, in the robot's base frame, tied by a best fit of all commanded poses. A motion "
            "of all poses as one rigid body is not observable by such a tie."
        ),
        *table(
            "AP_p, mm; held out: the frames tied by all other poses",
            ("pose", "AP_p", f"{level} interval", "held out"),
            rows,
        ),
        *table("AP along the axes", ("pose", *axes), axes_rows),
    ]


def _distances(found: Json, level: str) -> list[Block]:
    rows = []
    for one in found["distances"] or ():
        ad, ad_interval = with_interval(one["ad_mm"], one["ad_interval_mm"])
        rd, rd_interval = with_interval(one["rd_mm"], one["interval_mm"])
        rows.append(
            [
                f"{one['from_pose_id']} – {one['to_pose_id']}",
                str(one["cycles"]),
                number(one["mean_mm"], one["standard_uncertainty_mm"]),
                ad,
                ad_interval,
                rd,
                rd_interval,
                number(one["noise_floor_mm"]),
            ]
        )
    columns = ("poses", "n", "mean", "AD", f"{level} interval", "RD", f"{level} interval", "floor")
    caption = "Distance accuracy AD and repeatability RD, mm"
    found_blocks = table(caption, columns, rows)
    return [heading("Distances: AD and RD (7.3)"), *found_blocks] if found_blocks else []


def _approaches(found: Json) -> list[Block]:
    rows = []
    for one in found["approach_variation"] or ():
        names = "; ".join(
            f"{direction['approach']}: {', '.join(direction['pose_ids'])} ({direction['cycles']})"
            for direction in one["directions"]
        )
        expected = (one["expected_variation"] or {}).get("vap_p_mm")
        rows.append([names, number(one["variation"]["vap_p_mm"]), number(expected)])
    found_blocks = table(
        "vAP_p, mm, and what the cycles' own scatter would give",
        ("directions (visits)", "vAP_p", "expected"),
        rows,
        wide=0,
    )
    return [heading("Multi-directional accuracy variation vAP (7.2.3)"), *found_blocks] if rows else []
