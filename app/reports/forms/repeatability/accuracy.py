"""Sections of a repeatability report on what is attained: AP, AD and RD, vAP."""

from __future__ import annotations

from app.reports.forms.blocks import (
    Block,
    heading,
    number,
    of_its_own_size,
    of_unknown_uncertainty,
    paragraph,
    table,
    with_interval,
)
from app.reports.forms.repeatability.figure_names import AP_AXES, AXES, TURN_AXES
from app.reports.forms.wording import Json


def accuracy_blocks(found: Json, level: str) -> list[Block]:
    """Return the section on AP, or why it is not determined."""
    rows, axes_rows, turns = [], [], []
    for pose in found["poses"]:
        one = pose["accuracy"]
        if one is None:
            continue
        known = one["interval"]["ap_p_mm"]
        value, interval = with_interval(one["ap_p_mm"], known)
        held_out, _ = with_interval(one["held_out"]["ap_p_mm"], known)
        if known is None:
            value = of_unknown_uncertainty(one["ap_p_mm"])
            held_out = of_unknown_uncertainty(one["held_out"]["ap_p_mm"])
        rows.append([pose["pose_id"], value, interval, held_out])
        axes_rows.append(
            [pose["pose_id"], *(with_interval(one[name], one["interval"][name])[0] for name in AP_AXES)]
        )
        turn = one.get("ap_rotation_vector_deg")
        if turn is not None and one["ap_roll_deg"] is None:
            turns.append([pose["pose_id"], *map(of_unknown_uncertainty, turn)])
    if not rows:
        return [
            heading("Pose accuracy AP (7.2.1)"),
            paragraph("Not determined: no commanded poses tie the robot's base to the measuring frame."),
        ]
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
        *table("AP along the axes", ("pose", *AXES), axes_rows),
        *table(
            "AP of orientation by rotation vectors, where roll and yaw mean nothing",
            ("pose", *TURN_AXES),
            turns,
        ),
    ]


def distance_blocks(found: Json, level: str) -> list[Block]:
    """Return the section on AD and RD; none without distances."""
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
                of_its_own_size(one["noise_floor_mm"]),
            ]
        )
    columns = ("poses", "n", "mean", "AD", f"{level} interval", "RD", f"{level} interval", "floor")
    caption = "Distance accuracy AD and repeatability RD, mm"
    found_blocks = table(caption, columns, rows)
    return [heading("Distances: AD and RD (7.3)"), *found_blocks] if found_blocks else []


def approach_blocks(found: Json) -> list[Block]:
    """Return the section on vAP; none where no pose is reached from several directions."""
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
