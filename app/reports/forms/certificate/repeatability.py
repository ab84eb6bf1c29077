"""Results of a repeatability report as quantities, pose by pose."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree.ElementTree import Element

from app.reports.forms.blocks import LEADING
from app.reports.forms.certificate.elements import (
    coverage_factor,
    element,
    figure,
    figures,
    plain,
    result,
    sections,
    written,
)
from app.reports.forms.repeatability import AP_AXES, RP_AXES, VERDICTS, repeatability_blocks
from app.reports.forms.wording import Json, words

Totals = Mapping[tuple[str, str, str | None], Json]
"""Rows of the uncertainty budget's totals by figure, pose, and the pose that a distance leads to."""
_ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")
_AS_TEXT = ("Multi-directional", "Steadiness", "Uncertainty budget", "Outliers", "Excluded", "Warnings")


def repeatability_results(found: Json, inputs: Json) -> list[Element]:
    """Return the results; `found` is the analysis, `inputs` what it was computed from."""
    level = found["confidence_level"]
    totals = {
        (one["figure"], one["pose_id"], one["to_pose_id"]): one for one in found.get("budget_totals") or ()
    }
    commanded = {pose["pose_id"]: pose for pose in inputs["poses"]}
    results: list[Element] = []
    for pose in found["poses"]:
        quantities = [
            *figure("Cycles", "cycles", pose["cycles"]),
            *_pose("Commanded pose in the robot's base frame", "commanded", commanded.get(pose["pose_id"])),
            *_pose("Mean attained pose in the measuring frame", "mean", pose["mean"]),
            *_repeatability(pose, totals, level),
            *_accuracy(pose, totals, level),
        ]
        verdict = f"Verdict on RP_l: {words(pose['verdict'])}. {VERDICTS[pose['verdict']]}"
        results += result(f"Pose {pose['pose_id']}", quantities, verdict)
    first = [
        found_result
        for one in found["warnings"]
        if one["code"] in LEADING
        for found_result in result(LEADING[one["code"]], [written("dcc:text", one["detail"], one["advice"])])
    ]
    return [
        *first,
        *results,
        *_distances(found, totals, level),
        *_drift(found),
        *sections(repeatability_blocks(found, inputs), _AS_TEXT),
    ]


def conformity(found: Json) -> list[Element]:
    """Return the decisions on the data sheet's limits, as metadata of the measurement."""
    stated = []
    for name, key, symbol in (
        ("acceptance", "datasheet_repeatability_mm", "RP_l"),
        ("accuracy_acceptance", "datasheet_accuracy_mm", "AP_p"),
    ):
        one = found[name]
        if one is None:
            continue
        decided = one["decision"] if one["decision"] in ("pass", "fail") else None
        limit = figure(f"Limit of {symbol} by the data sheet", key, one[key])
        stated.append(
            element(
                "dcc:metaData",
                written("dcc:name", f"{symbol} against the data sheet"),
                plain("dcc:norm", one["rule"]),
                written("dcc:declaration", f"{words(one['decision'])}: {one['reason']}"),
                plain("dcc:conformity", decided) if decided else None,
                element("dcc:data", *limit),
            )
        )
    return [element("dcc:measurementMetaData", *stated)] if stated else []


def _pose(name: str, key: str, pose: Json | None) -> list[Element]:
    if pose is None or pose["position_mm"] is None:
        return []
    axes = ("x_mm", "y_mm", "z_mm")
    position = dict(zip(axes, pose["position_mm"], strict=True))
    angles = {angle: pose[angle] for angle in _ANGLES if pose[angle] is not None}
    return figures(name, key, {**position, **angles})


def _repeatability(pose: Json, totals: Totals, level: float) -> list[Element]:
    of = (pose["pose_id"], None)
    found: list[Element] = []
    for name, part, intervals in (
        ("RP_l (ISO 9283:1998, 7.2.2)", "repeatability", "interval"),
        ("RP_l that the noise alone gives", "noise_floor", None),
        ("RP_l corrected for the noise", "corrected", "corrected_interval"),
    ):
        value = pose[part]["rp_l_mm"]
        if part == "corrected" and pose["corrected_interval"]["rp_l_mm"] is None:
            value = None  # it says nothing of the robot
        found += figure(
            name,
            f"{part}.rp_l_mm",
            value,
            **_uncertainty(totals.get((f"{part}.rp_l_mm", *of))),
            interval=pose[intervals]["rp_l_mm"] if intervals else None,
            level=level,
        )
    rest, whole = pose.get("without_outliers") or {}, pose.get("including_degraded") or {}
    return [
        *found,
        *_axes("RP: 3 S", "repeatability", RP_AXES, pose["repeatability"], pose["interval"], level),
        *figure(
            "RP_l without the outliers, for comparison alone",
            "without_outliers.rp_l_mm",
            rest.get("rp_l_mm"),
        ),
        *figure(
            "RP_l with degraded images, for comparison alone",
            "including_degraded.rp_l_mm",
            whole.get("rp_l_mm"),
        ),
    ]


def _accuracy(pose: Json, totals: Totals, level: float) -> list[Element]:
    one = pose["accuracy"]
    if one is None:
        return []
    key = "accuracy.ap_p_mm"
    return [
        *figure(
            "AP_p (ISO 9283:1998, 7.2.1)",
            key,
            one["ap_p_mm"],
            **_uncertainty(totals.get((key, pose["pose_id"], None))),
            interval=one["interval"]["ap_p_mm"],
            level=level,
        ),
        *figure(
            "AP_p, frames tied by all other poses", "accuracy.held_out.ap_p_mm", one["held_out"]["ap_p_mm"]
        ),
        *_axes("AP", "accuracy", AP_AXES, one, one["interval"], level),
    ]


def _uncertainty(total: Json | None) -> dict[str, float]:
    """Return standard uncertainty and coverage factor as the budget states them."""
    return {} if total is None else {"u": total["standard_uncertainty_mm"], "k": total["coverage_factor"]}


def _axes(
    name: str, key: str, axes: tuple[str, ...], values: Json, intervals: Json, level: float
) -> list[Element]:
    """Return figures along and about the axes, and the ends of their intervals as lists of their own."""
    known = [axis for axis in axes if values[axis] is not None]
    found = figures(f"{name} along the axes", key, {axis: values[axis] for axis in known})
    bounded = [axis for axis in known if intervals[axis] is not None]
    for end, which in enumerate(("lower", "upper")):
        found += figures(
            f"{name} along the axes, {which} ends of the {100.0 * level:g} % intervals",
            f"{key}.interval.{which}",
            {axis: intervals[axis][end] for axis in bounded},
        )
    return found


def _distances(found: Json, totals: Totals, level: float) -> list[Element]:
    results: list[Element] = []
    for one in found["distances"] or ():
        ends = (one["from_pose_id"], one["to_pose_id"])
        total = totals.get(("distances.ad_mm", *ends))
        quantities = [
            *figure("Cycles", "cycles", one["cycles"]),
            *figure(
                "Mean distance",
                "mean_mm",
                one["mean_mm"],
                u=one["standard_uncertainty_mm"],
                # What was commanded is exact: the mean is as uncertain as AD. Without a command, by its cycles.
                k=total["coverage_factor"] if total is not None else coverage_factor(one["cycles"] - 1),
            ),
            *figure(
                "AD (ISO 9283:1998, 7.3)",
                "ad_mm",
                one["ad_mm"],
                **_uncertainty(total),
                interval=one["ad_interval_mm"],
                level=level,
            ),
            *figure(
                "RD (ISO 9283:1998, 7.3)", "rd_mm", one["rd_mm"], interval=one["interval_mm"], level=level
            ),
            *figure("RD that the noise alone gives", "noise_floor_mm", one["noise_floor_mm"]),
        ]
        results += result(f"Distance from pose {ends[0]} to pose {ends[1]}", quantities)
    return results


def _drift(found: Json) -> list[Element]:
    results: list[Element] = []
    for one in found["drift"]["poses"] if found["drift"] is not None else ():
        quantities = [
            quantity
            for axis, shift, u, freedom in zip(
                "xyz",
                one["shift_mm"],
                one["shift_standard_uncertainty_mm"],
                one.get("shift_degrees_of_freedom") or (None,) * 3,
                strict=True,
            )
            for quantity in figure(
                f"Shift along {axis}", f"shift_{axis}_mm", shift, u=u, k=coverage_factor(freedom)
            )
        ]
        # The tie of the frames adds to dAP what has more degrees of freedom than the blocks: theirs are the fewest.
        k = coverage_factor(one.get("shift_distance_degrees_of_freedom"))
        length_u, dap_u = (one.get(f"{of}_standard_uncertainty_mm") for of in ("shift_distance", "dap"))
        quantities += figure("Shift", "shift_distance_mm", one["shift_distance_mm"], u=length_u, k=k)
        quantities += figure("dRP_l", "drp_mm", one["drp_mm"])
        quantities += figure("dAP_p", "dap_mm", one.get("dap_mm"), u=dap_u, k=k)
        results += result(
            f"Drift of pose {one['pose_id']} (ISO 9283:1998, 7.6)",
            quantities,
            "From the first block of ten cycles to the last.",
        )
    return results
