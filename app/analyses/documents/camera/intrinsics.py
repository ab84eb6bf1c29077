"""The cameras of a session as the API shows them, with how its targets lie to one another and their shape."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, cast

from app.analyses.documents.camera.projection_field import projection_document, projection_field
from app.analyses.documents.camera.residual_field import radial_residuals, residual_field
from app.analyses.documents.encoding import camera_fields, target_transform_document
from app.analyses.documents.findings import Findings
from app.reports.camera_plots.radial_bins import radial_bins
from app.reports.camera_plots.residual_cells import cells_of, residual_figures
from core.calibration import Deformation, LensEvidence, Measure
from core.geometry import LensModel, fold_radius_px
from core.session import (
    FocusGroup,
    RefinedTarget,
    SessionData,
    estimate_session,
    observed_radius,
    refine_target,
    target_transforms,
    with_print_uncertainty,
    worst_poses,
)


def intrinsics_findings(data: SessionData, settings: Mapping[str, str]) -> Findings:
    """Return what `GET .../intrinsics` answers."""
    asked = cast("LensModel | None", settings.get("lens_model"))  # the route admits no other names
    estimate, shape = estimate_session(data, settings["estimator"], asked, weak=True), None
    if settings.get("refine_target") == "true":
        refined = refine_target(data, estimate)
        estimate, shape = refined.estimate, _shape(refined, data)
    estimate = with_print_uncertainty(data, estimate)
    fields = {
        "estimator": settings["estimator"],
        "groups": [
            {
                **camera_fields(group),
                **_lens(group),
                "covariance": group.estimate.camera_covariance.tolist(),
                "highest_residuals": [
                    {"measurement_id": pose.measurement_id, "rms_px": pose.rms_px}
                    for pose in worst_poses(group)
                ],
                **_residuals(group),
                "projection_uncertainty": projection_document(projection_field(group)),
            }
            for group in estimate.groups
        ],
        "target_transforms": [
            target_transform_document(found, data, range(len(data.targets)))
            for found in target_transforms(data, estimate)
        ],
        "target_shape": shape,
    }
    return Findings(fields, estimate.excluded.values(), estimate.warnings)


def _lens(group: FocusGroup) -> dict[str, Any]:
    evidence = group.evidence
    return {
        "lens_evidence": None
        if evidence is None
        else {"statistic": evidence.statistic, "share": evidence.share, "held_out": _held_out(evidence)},
        "observed_radius_px": observed_radius(group),
        "fold_radius_px": fold_radius_px(group.estimate.camera),
    }


def _held_out(evidence: LensEvidence) -> dict[str, float] | None:
    return None if evidence.held_out is None else {"rms_ratio": evidence.held_out}


def _residuals(group: FocusGroup) -> dict[str, Any]:
    """Return what the lens model leaves over, by place in the image and by distance from the principal point."""
    field = residual_field(group)
    cells = cells_of(field)
    by_place = zip(
        cells.middle_px.tolist(),
        cells.count.tolist(),
        cells.mean_px.tolist(),
        cells.rms_px.tolist(),
        cells.stands_out.tolist() if len(cells.count) else [],
        strict=True,
    )
    rings = radial_bins(radial_residuals(group), observed_radius(group))
    by_radius = zip(
        rings.middle_px.tolist(),
        rings.count.tolist(),
        rings.mean_px.tolist(),
        rings.error_px.tolist(),
        strict=True,
    )
    return {
        "residual_map": {
            **asdict(residual_figures(field, cells)),
            "mean_residuals": [
                {
                    "u_px": u,
                    "v_px": v,
                    "point_count": count,
                    "residual_u_px": mean_u,
                    "residual_v_px": mean_v,
                    "rms_px": rms,
                    "beyond_chance": beyond,
                }
                for (u, v), count, (mean_u, mean_v), rms, beyond in by_place
            ],
        },
        "radial_residuals": [
            {"radius_px": radius, "point_count": count, "mean_px": mean, "standard_uncertainty_px": error}
            for radius, count, mean, error in by_radius
        ],
    }


def _shape(refined: RefinedTarget, data: SessionData) -> dict[str, Any]:
    shape = refined.shape
    degrees = math.degrees(1.0)
    measures = {
        "bow_x_mm": shape.bow_x_mm,
        "bow_y_mm": shape.bow_y_mm,
        "twist_mm": shape.twist_mm,
        "aspect": shape.aspect,
        "shear_deg": Measure(degrees * shape.shear.value, degrees * shape.shear.standard_uncertainty),
    }
    return {
        "target_id": data.target_ids[refined.target],
        "focus_group": refined.focus_group,
        "image_count": refined.images,
        "view_directions": shape.directions,
        "used_for_calibration": refined.applied,
        "rms_before_px": shape.rms_before_px,
        "rms_px": shape.rms_px,
        "reduced_chi2": shape.reduced_chi2,
        "in_plane": _deformation(shape.in_plane),
        "out_of_plane": _deformation(shape.out_of_plane),
        **{name: measure.value for name, measure in measures.items()},
        "standard_uncertainty": {name: m.standard_uncertainty for name, m in measures.items()},
        "points": [
            {"column": column, "row": row, "deviation_mm": deviation, "deviation_sigma_mm": u}
            for column, row, deviation, u in zip(
                shape.column.tolist(),
                shape.row.tolist(),
                shape.deviations_mm.tolist(),
                shape.standard_uncertainty_mm.tolist(),
                strict=True,
            )
        ],
    }


def _deformation(found: Deformation) -> dict[str, Any]:
    return {
        "rms_mm": found.rms_mm,
        "standard_uncertainty_mm": found.standard_uncertainty_mm,
        "noise_mm": found.noise_mm,
        "largest_mm": found.largest_mm,
        "significant": found.significant,
    }
