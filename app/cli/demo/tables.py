"""The demo's tables of estimates and truth, which fit into 80 columns."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from rich.markup import escape
from rich.table import Table

from app.cli.demo.evaluation import Figure, ImageError, root_mean_square
from app.cli.demo.paper_figures import POSES, PRINTED
from app.client import Json

METHODS = {
    "proposed_nullspace": "proposed, null space",
    "proposed_vanishing_point": "proposed, vanishing pts",
    "zhang": "Zhang, all views",
    "opencv_single_image": "OpenCV, single image",
    "tsai": "Tsai",
    "dlt": "DLT",
    "five_points": "Five points (Miyagawa)",
    "lines": "Lines (Zhou)",
    "aruco_marker": "ArUco, one marker",
    "aruco_board": "ArUco, whole board",
    "pooled": "pooled (Gridpose)",
}
_ANGLES = ("rp_roll_deg", "rp_pitch_deg", "rp_yaw_deg")


def image_table(errors: Sequence[ImageError]) -> Table:
    """Return how single images came out, pose by pose: medians, and roots of mean squares of error over u."""
    table = plain_table(
        "Single images: camera pose and focal length, medians by pose",
        *("pose", "images", "error mm", "± u", "err/u", "error °", "± u", "err/u", "f error px", "± u"),
    )
    for pose_id in dict.fromkeys(e.pose_id for e in errors):
        rows = [e for e in errors if e.pose_id == pose_id]

        def median(name: str, rows: Sequence[ImageError] = rows) -> float:
            return float(np.median([getattr(row, name) for row in rows]))

        table.add_row(
            pose_id,
            str(len(rows)),
            f"{median('position_error_mm'):.2f}",
            f"{median('position_uncertainty_mm'):.2f}",
            f"{root_mean_square([r.position_ratio for r in rows]):.2f}",
            f"{median('rotation_error_deg'):.3f}",
            f"{median('rotation_uncertainty_deg'):.3f}",
            f"{root_mean_square([r.rotation_ratio for r in rows]):.2f}",
            f"{float(np.median([abs(r.focal_error_px) for r in rows])):.2f}",
            f"{median('focal_uncertainty_px'):.2f}",
        )
    return table


def position_table(figures: Sequence[Figure]) -> Table:
    """Return the paper's Table III for positions: truth, raw and corrected figures, noise floor and verdict."""
    table = plain_table(
        "Table III, position: RP_l by ISO 9283, mm (estimator pooled)",
        *("pose", "true", "these cycles", "raw", "95 % interval", "corrected", "floor", "verdict"),
        left=("pose", "verdict"),
    )
    for f in figures:
        if f.name == "rp_l_mm":
            values = [f"{v:.4f}" for v in (f.true, f.of_these_cycles, f.raw)]
            table.add_row(
                f.pose_id,
                *values,
                f"{f.low:.4f} - {f.high:.4f}",
                f"{f.corrected:.4f}",
                f"{f.floor:.4f}",
                f.verdict.replace("_", " "),
            )
    return table


POSE_LEGEND = """
RP            position repeatability: radius within which the robot comes back
95 % interval where the robot's true RP lies
noise floor   RP that the images alone would show of a robot that stands still
true          RP of the simulated robot in the long run
verdict       robot: the scatter is the robot's, not the instrument's"""


def pose_table(figures: Sequence[Figure], images: Mapping[str, int]) -> Table:
    """Return the position repeatability of each pose, given how many images of it count."""
    table = plain_table(
        "Position repeatability (ISO 9283, RP_l) of each pose, mm",
        *("pose", "images", "RP", "95 % interval", "noise floor", "true", "verdict"),
        left=("verdict",),
    )
    for f in figures:
        if f.name == "rp_l_mm":
            table.add_row(
                f.pose_id,
                str(images[f.pose_id]),
                f"{f.raw:.4f}",
                f"{f.low:.4f} - {f.high:.4f}",
                f"{f.floor:.4f}",
                f"{f.true:.4f}",
                f.verdict.replace("_", " "),
            )
    return table


def orientation_table(figures: Sequence[Figure]) -> Table:
    """Return the paper's Table III for angles."""
    table = plain_table(
        "Table III, orientation: 3 S, degrees (estimator pooled)",
        *("pose", "angle", "true", "these cycles", "raw", "95 % interval", "corrected", "floor"),
        left=("pose", "angle"),
    )
    for f in figures:
        if f.name in _ANGLES:
            values = [f"{v:.4f}" for v in (f.true, f.of_these_cycles, f.raw)]
            interval = f"{f.low:.4f} - {f.high:.4f}"
            angle = f.name.removeprefix("rp_").removesuffix("_deg")
            table.add_row(f.pose_id, angle, *values, interval, f"{f.corrected:.4f}", f"{f.floor:.4f}")
    return table


def methods_table(comparison: Json, fixed_centre: Json, figures: Sequence[Figure]) -> Table:
    """Return RP_l of every method on these images, and what the paper printed of its own."""
    table = plain_table(
        "Table III by every method: RP_l, mm; largest 3 S of an angle, °",
        *("", *POSES, "angle"),
    )
    truth = {(f.pose_id, f.name): f.true for f in figures}
    worst = max((value for (_, name), value in truth.items() if name in _ANGLES), default=math.nan)
    positions = [truth.get((pose_id, "rp_l_mm")) for pose_id in POSES]
    table.add_row("[bold]true[/]", *(_or_dash(value) for value in positions), f"{worst:.3f}")
    for row in comparison["repeatabilities"]:
        table.add_row(METHODS[row["method"]], *_readings(row["poses"]))
    table.add_row("each image, centre held", *_readings(fixed_centre["poses"]))
    for name, printed in PRINTED.items():
        largest = max(max(printed[angle]) for angle in _ANGLES)
        values = (f"{value:.3f}" for value in printed["rp_l_mm"])
        table.add_row(f"[italic]the paper: {name}[/]", *values, f"{largest:.3f}")
    return table


def _readings(poses: Sequence[Json]) -> list[str]:
    """Return RP_l of P1 to P5 and the largest 3 S of an angle, as far as they are known."""
    found = {pose["pose_id"]: pose["repeatability"] for pose in poses if pose["pose_id"] in POSES}
    positions = [found[p]["rp_l_mm"] if p in found else None for p in POSES]
    angles = [figures[a] for figures in found.values() for a in _ANGLES if figures[a] is not None]
    return [*(_or_dash(value) for value in positions), _or_dash(max(angles, default=None))]


def calibration_table(comparison: Json, true_focal_px: float) -> Table:
    """Return the paper's Table II: re-projection, and what it does not say, how far the focal length is off."""
    table = plain_table(
        "Table II, the same images: re-projection and focal length, px",
        *("", "images", "mean", "std", "f", "error", "spread"),
    )
    for row in comparison["calibrations"]:
        seen, camera, spread = row["reprojection"], row["intrinsics"], row["standard_deviation"]
        focal = camera["fx_px"] if camera else None
        table.add_row(
            METHODS[row["method"]],
            f"{row['calibrated']}/{row['calibrated'] + row['failed']}",
            *(_or_dash(seen and seen[name], 4) for name in ("mean_px", "std_px")),
            _or_dash(focal, 1),
            "-" if focal is None else f"{focal - true_focal_px:+.1f}",
            _or_dash(spread and spread["fx_px"], 1),
        )
    return table


def _or_dash(value: float | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def failures_of(comparison: Json) -> list[str]:
    """Return in words why methods gave no answer, or none for some images; what several share is said once."""
    said: dict[str, list[str]] = {}
    for row in comparison["calibrations"]:
        name = METHODS[row["method"]]
        if row["failure"]:
            said.setdefault(row["failure"]["detail"], []).append(name)
            continue
        images = row["calibrated"] + row["failed"]
        for failure in row["failures"]:
            said.setdefault(f"{failure['image_count']} of {images}: {failure['detail']}", []).append(name)
    return [f"{' and '.join(names)}: {detail}" for detail, names in said.items()]


def refusal_table(measurements: Sequence[Json]) -> Table:
    """Return the images that got no answer, with the reason and the way out."""
    table = Table(
        title="Refused, rather than answered wrongly",
        title_justify="left",
        title_style="bold",
        pad_edge=False,
    )
    for name in ("image", "why", "what to do"):
        table.add_column(name, overflow="fold")
    for m in measurements:
        failure = m["failure"]
        why = f"{failure['code']}: {failure['detail']}"
        table.add_row(f"{m['pose_id']}/c{m['cycle']}", escape(why), escape(failure["advice"] or ""))
    return table


def plain_table(title: str, first: str, *others: str, left: Sequence[str] = ()) -> Table:
    table = Table(
        title=title, title_justify="left", title_style="bold", box=None, padding=(0, 2, 0, 0), pad_edge=False
    )
    table.add_column(first, no_wrap=True)
    for name in others:
        table.add_column(name, justify="left" if name in left else "right", no_wrap=True)
    return table
