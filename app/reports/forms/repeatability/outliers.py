"""The section of a repeatability report about its outliers, RP without them, and RP with the cycles of degraded images:
both second to RP over the cycles that count.
"""

from __future__ import annotations

from app.reports.forms.blocks import Block, heading, number, paragraph, table, with_interval
from app.reports.forms.repeatability.figure_names import AXES, RP_AXES
from app.reports.forms.wording import Json, reading_id, words


def outlier_blocks(found: Json) -> list[Block]:
    """Return the section on outliers."""
    rows = [
        [pose["pose_id"], _name(one), words(one["code"]), one["detail"], number(one["distance_mm"])]
        for pose in found["poses"]
        for one in pose["outliers"]
    ]
    if not rows:
        none = paragraph("None. Outliers, where there are any, count in every figure.")
        return [heading("Outliers"), none, *with_degraded_table(found)]
    columns = ("pose", "cycle", "test", "detail", "distance, mm")
    return [
        heading("Outliers"),
        *table("Outliers; they count in every figure", columns, rows, text_columns=4, wide=3),
        *without_outliers_table(found),
        *with_degraded_table(found),
    ]


def without_outliers_table(found: Json) -> list[Block]:
    """Return RP over all cycles and RP without the outliers, of each pose that has some; no block without any."""
    names = ("rp_l_mm", *RP_AXES)
    rows = []
    for pose in found["poses"]:
        rest = pose.get("without_outliers")
        if rest is None:
            continue
        over_all = [with_interval(pose["repeatability"][one], pose["interval"][one])[0] for one in names]
        others = pose["cycles"] - len(_outlying(pose))
        rows += [
            [pose["pose_id"], "all, as reported", str(pose["cycles"]), *over_all],
            [pose["pose_id"], f"without {_named(pose)}", str(others), *(number(rest[one]) for one in names)],
        ]
    caption = (
        "RP without the outliers, for comparison alone: the figures of this report are those over all cycles, since "
        "ISO 9283 rejects none"
    )
    return table(caption, ("pose", "cycles", "n", "RP_l, mm", *AXES), rows, text_columns=2, wide=1)


def with_degraded_table(found: Json) -> list[Block]:
    """Return RP over the cycles that count and RP with those of degraded images; no block without any."""
    names = ("rp_l_mm", *RP_AXES)
    rows = []
    for pose in found["poses"]:
        whole = pose.get("including_degraded")
        if whole is None:
            continue
        counted = [with_interval(pose["repeatability"][one], pose["interval"][one])[0] for one in names]
        rows += [
            [pose["pose_id"], "those that count, as reported", *counted],
            [pose["pose_id"], "with degraded images", *(number(whole[one]) for one in names)],
        ]
    caption = "RP with the cycles of degraded images, which do not count; for comparison alone"
    return table(caption, ("pose", "cycles", "RP_l, mm", *AXES), rows, text_columns=2, wide=1)


def without_outliers_fact(pose: Json) -> list[tuple[str, str]]:
    """Return a pose's RP_l without its outliers as a label with its value; none without outliers."""
    rest = pose.get("without_outliers")
    if rest is None or rest["rp_l_mm"] is None:
        return []
    count = "it counts" if len(_outlying(pose)) == 1 else "they count"
    said = f"{number(rest['rp_l_mm'])} mm without {_named(pose)}, for comparison alone: {count} above"
    return [("without its outliers", said)]


def _outlying(pose: Json) -> dict[str | None, str]:
    """Return the cycles of a pose that are outliers by their measurements; one may be so by several tests."""
    return {reading_id(one): _name(one) for one in pose["outliers"]}


def _named(pose: Json) -> str:
    cycles = list(_outlying(pose).values())
    return f"{'cycle' if len(cycles) == 1 else 'cycles'} {', '.join(cycles)}"


def _name(outlier: Json) -> str:
    """Return what a cycle is named by: its number, else its measurement."""
    return str(outlier["named"] if outlier["cycle"] is None else outlier["cycle"])
