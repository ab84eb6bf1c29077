"""Sections of a camera report: the camera of each focus group, its lens model, residuals and the target's shape."""

from __future__ import annotations

from typing import Any

from app.reports.forms.blocks import (
    Block,
    excluded_of,
    facts,
    heading,
    number,
    paragraph,
    table,
    warnings_of,
)
from app.reports.forms.wording import Json, words


def camera_blocks(found: Json, inputs: Json) -> list[Block]:
    """Return the sections; `found` is the analysis `intrinsics`."""
    blocks = [block for group in found["groups"] for block in _group(group)]
    if found["target_shape"]:
        shapes = found["target_shape"]
        blocks += _shapes(shapes if isinstance(shapes, list) else [shapes])
    return [*blocks, *excluded_of(found, inputs), *warnings_of(found)]


def estimated_terms(group: Json) -> list[tuple[str, float]]:
    """Return intrinsics and distortion by name, without terms that are held at zero: the model does not have them."""
    u = group["standard_uncertainty"]
    return [
        (name, value)
        for part in ("intrinsics", "distortion")
        for name, value in group[part].items()
        if value != 0.0 or u.get(name) != 0.0
    ]


def _group(group: Json) -> list[Block]:
    u = group["standard_uncertainty"]
    rows = [
        [
            name.removesuffix("_px"),
            "px" if name.endswith("_px") else "1",
            number(value, u.get(name)),
            "held" if u.get(name) == 0.0 else _u(u.get(name)),
        ]
        for name, value in estimated_terms(group)
    ]
    absent = [name for name in group["distortion"] if name not in dict(estimated_terms(group))]
    evidence = group["lens_evidence"]
    lines: list[tuple[str, Any]] = [
        ("images", str(group["image_count"])),
        ("lens model", words(group["lens_model"])),
        *([("not in the model, zero", ", ".join(absent))] if absent else []),
        ("reduced χ²", number(group["reduced_chi2"], places=3)),
    ]
    if evidence is not None and evidence.get("statistic") is not None:
        lines.append(("evidence against Brown's model", number(evidence["statistic"], places=2)))
    if group["observed_radius_px"] is not None:
        lines.append(("observed up to a radius of", f"{number(group['observed_radius_px'], places=0)} px"))
    residuals = group["residual_map"]
    if residuals is not None:
        lines += [
            ("grid points", f"{residuals['point_count']}, of them {residuals['outlier_count']} outliers"),
            ("residual rms", f"{number(residuals['rms_px'])} px"),
        ]
    projection = group.get("projection_uncertainty")  # documents of earlier builds have none
    if projection is not None:
        lines.append(("points in", f"{100.0 * projection['covered_share']:.0f} % of the image"))
        lines.append(("blank areas", ", ".join(projection["blank_areas"]) or "none"))
    areas = [
        [
            one["name"],
            str(one["point_count"]),
            f"{100.0 * one['blank_share']:.0f}",
            _u(one["standard_uncertainty_px"]),
        ]
        for one in (projection["areas"] if projection is not None else ())
    ]
    worst = [[one["named"], number(one["rms_px"])] for one in group["highest_residuals"]]
    return [
        heading(f"Camera of focus group {group['focus_group']}"),
        facts(lines),
        *table(
            "Intrinsics and distortion with standard uncertainties",
            ("parameter", "unit", "value", "standard uncertainty"),
            rows,
            text_columns=2,
        ),
        *table(
            "Projection uncertainty of a point at infinity, by parts of the image",
            ("part", "grid points", "without points, %", "largest standard uncertainty, px"),
            areas,
        ),
        *table("Images with the highest residuals", ("image", "rms, px"), worst),
    ]


def _shapes(shapes: list[Json]) -> list[Block]:
    rows = [
        [
            shape["named"],
            str(shape["image_count"]),
            f"{number(shape['in_plane']['rms_mm'], shape['in_plane']['standard_uncertainty_mm'])}",
            f"{number(shape['out_of_plane']['rms_mm'], shape['out_of_plane']['standard_uncertainty_mm'])}",
        ]
        for shape in shapes
    ]
    if not rows:
        return []
    return [
        heading("Shape of the target"),
        paragraph("Deviations of the grid points from the stated target, root mean square."),
        *table("Target's shape", ("target", "images", "in plane, mm", "out of plane, mm"), rows),
    ]


def _u(value: float | None) -> str:
    return number(value, value) if value is not None else "–"
