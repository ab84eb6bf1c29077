"""What an overlay says of a measurement: verdict, reason, advice and figures, all of which are in its JSON as well."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from app.jobs.painting.subject import OverlaySubject
from app.reports.overlay import Statement, Verdict

_MAX_WARNINGS = 3


def statement_of(subject: OverlaySubject, brightening: float, *, is_whole: bool) -> Statement:
    """Return the text of a measurement's overlay.

    `brightening` is what the image's grey values were multiplied by for the drawing, `is_whole` whether all of the file
    could be decoded.
    """
    measurement = subject.measurement
    failure, calibration = measurement["failure"], measurement["calibration"]
    verdict: Verdict
    if failure is not None:
        verdict, word = "refused", f"Not calibrated ({failure['code']})"
    elif calibration is not None:
        grade = calibration.get("grade")
        verdict, word = "measured", "Measured" if grade is None else f"Measured ({grade})"
    else:
        verdict, word = "waiting", "Not measured yet"
    cycle = "" if measurement["cycle"] is None else f", cycle {measurement['cycle']}"
    return Statement(
        verdict,
        f"{word}: pose {measurement['pose_id']}{cycle}",
        tuple(_sentences(subject, is_whole=is_whole)),
        tuple(_figures(measurement, brightening)),
    )


def _sentences(subject: OverlaySubject, *, is_whole: bool) -> Iterator[str]:
    measurement = subject.measurement
    failure, calibration, quality = (measurement[k] for k in ("failure", "calibration", "capture_quality"))
    if failure is not None:
        yield failure["detail"]
        if failure["advice"]:
            yield f"Advice: {failure['advice']}"
        if subject.points:
            yield "The grid points count in the estimates of the whole session all the same."
    elif calibration is None:
        yield f"The measurement is {measurement['status']}; ask again when it has succeeded or failed."
    if measurement["excluded"] is not None:
        yield f"Excluded from all analyses: {measurement['excluded']['reason']}"
    if not is_whole:
        yield "The file is damaged: what can be decoded of it is shown."
    warnings = calibration["warnings"] if calibration is not None else []
    # What makes the grade comes first.
    warnings = sorted(warnings, key=lambda warning: warning["code"] != "focal_weakly_observable")
    for warning in warnings[:_MAX_WARNINGS]:
        yield f"Warning: {warning['detail']}"
    if (more := len(warnings) - _MAX_WARNINGS) > 0:
        yield f"{more} more {'warning is' if more == 1 else 'warnings are'} in the measurement."
    for one in quality["warnings"] if quality is not None else ():
        yield f"Image: {one['advice'] or one['detail']}"


def _figures(measurement: dict[str, Any], brightening: float) -> Iterator[str]:
    calibration, quality = measurement["calibration"], measurement["capture_quality"]
    if calibration is not None:
        f, u = calibration["intrinsics"]["fx_px"], calibration["standard_uncertainty"]["fx_px"]
        x, y, z = calibration["pose"]["position_mm"]
        known = f" ± {_significant(u)}" if u > 0.0 else " (given)"
        yield (
            f"fx {f:.{_decimals(u)}f}{known} px, residuals rms {calibration['reprojection']['rms_px']:.2g} px, camera "
            f"at ({x:.1f}, {y:.1f}, {z:.1f}) mm in the target frame"
        )
    if quality is not None:
        yield ", ".join(quality_figures(quality))
    if brightening > 1.0:
        yield f"The image is dark: it is shown {brightening:.2g} times as bright as it is."


def quality_figures(quality: dict[str, Any]) -> list[str]:
    """Return the figures of an image's capture quality, those that are known."""
    figures = [
        _figure("edges", quality["edge_width_px"], "{:.1f} px"),
        _motion(quality),
        _figure("contrast", quality["contrast"], "{:.0%}"),
        _figure("white saturated", quality["saturated_fraction"], "{:.0%}"),
        _figure("black clipped", quality["clipped_fraction"], "{:.0%}"),
        _figure("target fills", quality["coverage_fraction"], "{:.0%} of the image"),
        _figure("tilt", quality["tilt_deg"], "{:.0f}°"),
    ]
    return [figure for figure in figures if figure is not None]


def _figure(name: str, value: float | None, form: str) -> str | None:
    return f"{name} {form.format(value)}" if value is not None else None


def _motion(quality: dict[str, Any]) -> str | None:
    length, direction = quality["motion_blur_px"], quality["motion_blur_direction_deg"]
    if length is None:
        return None
    return f"motion {length:.1f} px" + (f" at {direction:.0f}°" if direction is not None else "")


def _decimals(uncertainty: float) -> int:
    """Return how many decimals show two digits of an uncertainty."""
    return 2 if uncertainty <= 0.0 else max(0, 1 - math.floor(math.log10(uncertainty)))


def _significant(uncertainty: float) -> str:
    return f"{uncertainty:.{_decimals(uncertainty)}f}"
