"""An image's page: overlay, figures with their uncertainty in words, why it was refused, and its neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fastapi import Request
from starlette.responses import Response

from app.errors import RowUnreadable
from app.records.readable import unreadable_columns
from app.records.tables import Measurement, Target
from app.services.measurements import get_measurement, neighbours
from app.services.sessions import get_session
from app.web.pages import page_router, render
from app.web.routes.sessions import session_context
from app.web.service import service_of
from app.web.words import decimals_of, fixed, number, with_uncertainty

router = page_router()
VIEWABLE = ("png", "jpeg", "bmp")
"""Formats that browsers show; of others the overlay is shown as the server draws it."""


@dataclass(frozen=True, slots=True)
class Row:
    """A figure: its name, value with uncertainty, unit, and what it means."""

    name: str
    value: str
    unit: str
    meaning: str = ""


@router.get("/measurements/{measurement_id}", operation_id="get_measurement")
def show_measurement(request: Request, measurement_id: str) -> Response:
    """Show one image with everything that was found in it."""
    with service_of(request).installation.database.read() as records:
        view = get_measurement(records, measurement_id)
        measurement = view.measurement
        damaged = unreadable_columns(measurement)
        if damaged:
            raise RowUnreadable("measurement", damaged, "Retry the measurement, or restore a backup.")
        before, after = neighbours(records, measurement)
        result = measurement.result
        calibration = result.calibration if result is not None else None
        context = {
            **session_context(records, get_session(records, measurement.session_id), "images"),
            "measurement": measurement,
            "siblings": view.siblings,
            "target": records.get(Target, measurement.target_id) if measurement.target_id else None,
            "before": before,
            "after": after,
            "viewable": measurement.image_format in VIEWABLE,
            "pose_rows": pose_rows(calibration),
            "camera_rows": camera_rows(calibration),
            "quality_rows": quality_rows(measurement),
            "calibration": calibration,
            "warnings": (calibration or {}).get("warnings", []),
            "verdict_words": in_words(calibration),
        }
        return render(request, "sessions/measurement.html", **context)


def in_words(calibration: dict[str, Any] | None) -> str:
    """Return in a sentence how well the image determines camera and position."""
    if not calibration:
        return ""
    share = calibration["observability"]["focal_relative_uncertainty"]
    uncertainty = calibration["pose"]["standard_uncertainty"]
    axis = max("xyz", key=lambda one: uncertainty[f"{one}_mm"])
    points = calibration["reprojection"]["points"]
    return (
        f"{points} grid points determine the focal length to {number(100.0 * share, 2)} % and the camera's position to "
        f"{number(uncertainty[f'{axis}_mm'], 2)} mm along {axis}, where it is least certain (one standard deviation), "
        "from this image alone. Together with the session's other "
        "images both are far better known: see Repeatability and Camera."
    )


def pose_rows(calibration: dict[str, Any] | None) -> list[Row]:
    """Return the camera's pose in the target's frame."""
    if not calibration:
        return []
    pose = calibration["pose"]
    uncertainty = pose["standard_uncertainty"]
    rows = [
        Row(axis, with_uncertainty(value, uncertainty[f"{axis}_mm"]), "mm")
        for axis, value in zip("xyz", pose["position_mm"], strict=True)
    ]
    rows += [
        Row(name, with_uncertainty(pose[f"{name}_deg"], uncertainty[f"{name}_deg"]), "°")
        for name in ("roll", "pitch", "yaw")
    ]
    return rows


COVERAGE = 1.96
"""Standard uncertainties of half a 95 % interval."""
CAMERA_MEANINGS = {
    "fx_px": "focal length along the image's rows",
    "fy_px": "focal length along its columns",
    "cx_px": "principal point, from the left",
    "cy_px": "principal point, from the top",
    "p1": "tangential distortion",
    "p2": "tangential distortion",
}
_RADIAL_MEANINGS = {
    "brown": {f"k{k}": f"radial distortion, r{power}" for k, power in enumerate("²⁴⁶", 1)},
    "rational": {
        f"k{k}": f"radial distortion, r{power} {where}"
        for k, (power, where) in enumerate(
            [*((p, "above the line") for p in "²⁴⁶"), *((p, "below the line") for p in "²⁴⁶")], 1
        )
    },
    "kannala_brandt": {
        f"k{k}": f"θ{power} in θ(1 + k1θ² + …), θ the angle from the optical axis"
        for k, power in enumerate("²⁴⁶⁸", 1)
    },
}
"""Of the radial coefficients, by the lens model."""


def camera_meaning(name: str, model: str) -> str:
    """Return what a parameter of a lens model is."""
    return CAMERA_MEANINGS.get(name) or _RADIAL_MEANINGS[model].get(name, "distortion")


def camera_rows(camera: dict[str, Any] | None, lens_model: str = "brown") -> list[Row]:
    """Return a camera and its lens with standard uncertainty and 95 % interval; what was held says so."""
    if not camera:
        return []
    rows = []
    for name, value in {**camera["intrinsics"], **camera["distortion"]}.items():
        shown, unit = name.removesuffix("_px"), "px" if name.endswith("_px") else ""
        meaning = camera_meaning(name, lens_model)
        uncertainty = camera["standard_uncertainty"].get(name)
        decimals = decimals_of(uncertainty)
        if value is None or decimals is None or uncertainty is None:
            rows.append(Row(shown, f"{number(value, 6)} (held)", unit, meaning))
            continue
        reach = COVERAGE * uncertainty
        low, high = camera["interval_95"].get(name) or (value - reach, value + reach)
        bounds = f"95 %: [{fixed(low, decimals)}, {fixed(high, decimals)}]"
        rows.append(Row(shown, with_uncertainty(value, uncertainty), unit, f"{meaning}; {bounds}"))
    return rows


def quality_rows(measurement: Measurement) -> list[Row]:
    """Return how well the image was taken, and what the fit leaves."""
    result = measurement.result
    quality = (result.capture_quality if result is not None else None) or {}
    calibration = (result.calibration if result is not None else None) or {}
    rows = []
    reprojection, observability = calibration.get("reprojection"), calibration.get("observability")
    if reprojection:
        rows += [
            Row(
                "residuals, rms", number(reprojection["rms_px"]), "px", "observed minus predicted grid points"
            ),
            Row("largest residual", number(reprojection["max_px"]), "px"),
            Row("grid points", str(reprojection["points"]), "", f"{reprojection['rejected']} rejected"),
        ]
    if observability:
        rows.append(
            Row(
                "tilt of the target",
                fixed(observability["tilt_deg"], 1),
                "°",
                "30° to 45° determine the focal length",
            )
        )
    if quality.get("edge_width_px") is not None:
        rows.append(
            Row("edge width", number(quality["edge_width_px"]), "px", "sharp edges are 2 to 3 px wide")
        )
    if quality.get("motion_blur_px") is not None:
        rows.append(Row("motion blur", number(quality["motion_blur_px"], 2), "px"))
    if quality.get("saturated_fraction") is not None:
        rows.append(
            Row("saturated", number(100.0 * quality["saturated_fraction"], 2), "%", "of the grid's pixels")
        )
    if quality.get("contrast") is not None:
        rows.append(Row("contrast", number(quality["contrast"], 2), "", "1 is full black on full white"))
    if quality.get("coverage_fraction") is not None:
        rows.append(
            Row("covered", number(100.0 * quality["coverage_fraction"], 2), "%", "of the image, by the grid")
        )
    return rows
