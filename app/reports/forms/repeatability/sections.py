"""Sections of a repeatability report, in the order of ISO 9283: conditions, poses, RP, AP, AD, RD, vAP, drift."""

from __future__ import annotations

from collections.abc import Sequence

from app.reports.forms.blocks import (
    UNKNOWN,
    Block,
    excluded_of,
    facts,
    heading,
    notes,
    number,
    of_its_own_size,
    of_unknown_uncertainty,
    paragraph,
    table,
    vector,
    warnings_of,
    with_interval,
)
from app.reports.forms.repeatability.accuracy import accuracy_blocks, approach_blocks, distance_blocks
from app.reports.forms.repeatability.cycles import drift_blocks, steadiness_blocks
from app.reports.forms.repeatability.figure_names import AXES, RP_AXES, TURN_AXES, VERDICTS
from app.reports.forms.repeatability.outliers import (
    outlier_blocks,
    with_degraded_table,
    without_outliers_fact,
    without_outliers_table,
)
from app.reports.forms.repeatability.uncertainty_budget import budget_blocks
from app.reports.forms.wording import Json, words

_ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")


def repeatability_blocks(found: Json, inputs: Json) -> list[Block]:
    """Return the sections; `found` is the analysis, `inputs` what it was computed from."""
    level = f"{100.0 * found['confidence_level']:g} %"
    return [
        *_result(found, level),
        *_instrument(found),
        *_poses(found, inputs),
        *_repeatability(found, level),
        *accuracy_blocks(found, level),
        *distance_blocks(found, level),
        *approach_blocks(found),
        *drift_blocks(found),
        *steadiness_blocks(found),
        *budget_blocks(found),
        *outlier_blocks(found),
        *excluded_of(found, inputs),
        *warnings_of(found),
    ]


def headline(found: Json) -> list[Block]:
    """Return RP with its verdicts, and RP without the outliers, for a report on the whole session."""
    level = f"{100.0 * found['confidence_level']:g} %"
    others = (*without_outliers_table(found), *with_degraded_table(found))
    return [*_rp_table(found, level), *_verdict_notes(found), *others]


def _result(found: Json, level: str) -> list[Block]:
    known = [pose for pose in found["poses"] if pose["repeatability"]["rp_l_mm"] is not None]
    rows: list[tuple[str, str]] = []
    if known:
        worst = max(known, key=lambda pose: pose["repeatability"]["rp_l_mm"])
        reading, interval = worst["repeatability"]["rp_l_mm"], worst["interval"]["rp_l_mm"]
        floor_mm = worst["noise_floor"]["rp_l_mm"]
        rows = [
            ("largest RP_l", _at_pose(reading, interval, worst["pose_id"], level)),
            ("its noise floor", "not known" if floor_mm is None else f"{of_its_own_size(floor_mm)} mm"),
            ("its verdict", f"{words(worst['verdict'])}. {VERDICTS[worst['verdict']]}"),
            *without_outliers_fact(worst),
        ]
    # One visit gives an AP, and no RP.
    accurate = [
        pose for pose in found["poses"] if pose["accuracy"] and pose["accuracy"]["ap_p_mm"] is not None
    ]
    if accurate:
        worst = max(accurate, key=lambda pose: pose["accuracy"]["ap_p_mm"])
        one = worst["accuracy"]
        said = _at_pose(one["ap_p_mm"], one["interval"]["ap_p_mm"], worst["pose_id"], level)
        rows.append(("largest AP_p", said))
    blocks = [heading("Result")]
    if not known:
        blocks.append(paragraph("No repeatability is known: no pose has two visits that count."))
    if rows:
        blocks.append(facts(rows))
    for name, limit, figure, how in (
        (
            "acceptance",
            "datasheet_repeatability_mm",
            "RP_l",
            "corrected for the instrument's noise; before the robot passes, each by its own cycles alone, too",
        ),
        (
            "accuracy_acceptance",
            "datasheet_accuracy_mm",
            "AP_p",
            "in the frames that the other poses tie, too, so that intervals are wider than those of AP_p below",
        ),
    ):
        one = found[name]
        if one is not None:
            blocks.append(facts(_decision(one, f"{figure} against the data sheet", one[limit], level, how)))
    return blocks


def _decision(one: Json, title: str, limit_mm: float, level: str, how: str) -> list[tuple[str, str]]:
    """Return what is decided of a limit: by which rule and interval, why, and what would decide."""
    rows = [
        (title, f"{one['decision'].upper()}: limit {limit_mm:g} mm"),
        ("rule", f"{one['rule']}: all poses must keep the limit with their whole intervals, {how}"),
        ("reason", one["reason"]),
    ]
    if one.get("interval_mm") is not None:
        interval = with_interval(None, one["interval_mm"])[1]
        open_or_decided = "open at" if one["decision"] == "inconclusive" else "decided at"
        rows.append((open_or_decided, f"pose {one['pose_id']}, {level} interval {interval} mm"))
    if one.get("cycles_needed"):
        rows.append(("would decide", f"about {one['cycles_needed']} cycles"))
    if one.get("poses_needed"):
        rows.append(("would probably decide", f"about {one['poses_needed']} poses"))
    return rows


def _at_pose(value_mm: float, interval_mm: Sequence[float] | None, pose_id: str, level: str) -> str:
    if interval_mm is None:
        return f"{of_unknown_uncertainty(value_mm)} mm at pose {pose_id}, interval not known"
    value, interval = with_interval(value_mm, interval_mm)
    return f"{value} mm at pose {pose_id}, {level} interval {interval} mm"


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
    return [heading("Measuring instrument"), *found_blocks, *_bursts(found)] if found_blocks else []


def _bursts(found: Json) -> list[Block]:
    """Return that cycles are means of several images, whose scatter is the instrument's; nothing of single images."""
    bursts = found.get("bursts")
    if bursts is None:
        return []
    text = (
        f"A cycle is a stop of the robot, read as the mean of its images: {bursts['stop_count']} stops were seen in "
        f"several images, {bursts['image_count']} in all. Within stops they scatter "
    )
    sizes = [(name, bursts[f"of_{name}"]) for name in ("position", "orientation")]
    text += " and ".join(f"{number(one['ratio_to_model'], places=2)} times in {name}" for name, one in sizes)
    text += " what the noise of the grid points explains"
    added = [name for name, one in sizes if one["added"]]
    if added:
        text += f"; what they scatter beyond it in {' and '.join(added)} is in the floors"
    return [paragraph(f"{text}.")]


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
    if found["source"] != "images":
        frame = "probe in the instrument's frame"
    elif found["subject"].get("camera_mount") == "fixed":
        frame = "target in the frame of the fixed camera"
    else:
        frame = "camera in the target frame"
    return [
        heading("Poses"),
        *table(
            "Commanded poses in the robot's base frame, with the direction of approach",
            ("pose", *AXES, "approach"),
            stated,
        ),
        *table("Commanded joint angles, degrees", ("pose", "joints 1 …"), joints, text_columns=2),
        *table(f"Mean attained poses: {frame}", ("pose", "cycles", *AXES), attained),
    ]


def _rp_table(found: Json, level: str) -> list[Block]:
    rows = []
    for pose in found["poses"]:
        value, interval = with_interval(pose["repeatability"]["rp_l_mm"], pose["interval"]["rp_l_mm"])
        known = pose["corrected_interval"][
            "rp_l_mm"
        ]  # without an interval the value says nothing of the robot
        corrected, corrected_interval = with_interval(
            pose["corrected"]["rp_l_mm"] if known is not None else None, known
        )
        rows.append(
            [
                pose["pose_id"],
                words(pose["verdict"]),
                str(pose["cycles"]),
                value,
                interval,
                of_its_own_size(pose["noise_floor"]["rp_l_mm"]),
                corrected,
                corrected_interval,
            ]
        )
    columns = ("pose", "verdict", "n", "RP_l", f"{level} interval", "floor", "corrected", f"{level} interval")
    caption = "RP_l, mm (7.2.2), over all cycles; floor: what the noise alone gives; corrected for it where determined"
    return table(caption, columns, rows, text_columns=2)


def _repeatability(found: Json, level: str) -> list[Block]:
    known = [pose for pose in found["poses"] if pose["repeatability"]["rp_l_mm"] is not None]
    by_axis = [
        [
            pose["pose_id"],
            *(with_interval(pose["repeatability"][n], pose["interval"][n])[0] for n in RP_AXES),
        ]
        for pose in known
    ]
    intervals = [
        [
            pose["pose_id"],
            *(with_interval(pose["repeatability"][n], pose["interval"][n])[1] for n in RP_AXES),
        ]
        for pose in known
    ]
    return [
        heading("Pose repeatability RP (ISO 9283:1998, 7.2.2)"),
        *_rp_table(found, level),
        *_verdict_notes(found),
        *table("RP along the axes: 3 S", ("pose", *AXES), by_axis),
        *table(f"{level} intervals of RP along the axes", ("pose", *AXES), intervals),
        *_rotation_vectors(found),
    ]


def _rotation_vectors(found: Json) -> list[Block]:
    """Return the scatter of orientation without angles, where a warning says that these are magnified."""
    if all(one["code"] != "near_gimbal_lock" for one in found["warnings"]):
        return []
    rows = [
        [pose["pose_id"], *map(of_its_own_size, pose["orientation_scatter"]["rotation_vector_deg"])]
        for pose in found["poses"]
        if pose.get("orientation_scatter")
    ]
    return table("Scatter of orientation by rotation vectors: 3 S", ("pose", *TURN_AXES), rows)


def _verdict_notes(found: Json) -> list[Block]:
    codes = {pose["verdict"] for pose in found["poses"]}
    return notes([f"{words(code)}: {text}" for code, text in VERDICTS.items() if code in codes])
