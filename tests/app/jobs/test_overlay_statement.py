"""What an overlay says of a measurement: verdict, reason, advice and figures."""

from __future__ import annotations

from typing import Any

import pytest

from app.jobs.painting.statement import statement_of
from app.jobs.painting.subject import OverlaySubject

FAILURE = {"code": "target_not_found", "detail": "No grid was found.", "advice": "Show the whole grid."}
WARNING = {"code": "residuals_exceed_noise", "detail": "The residuals are large.", "advice": None}
CALIBRATION = {
    "intrinsics": {"fx_px": 528.966, "fy_px": 528.81, "cx_px": 344.437, "cy_px": 238.823},
    "standard_uncertainty": {"fx_px": 9.28},
    "pose": {"position_mm": [212.075, 33.7286, -261.411]},
    "reprojection": {"rms_px": 0.1607},
    "warnings": [WARNING] * 5,
}
QUALITY = {
    "edge_width_px": 2.94,
    "motion_blur_px": 1.23,
    "motion_blur_direction_deg": 157.0,
    "saturated_fraction": 0.12,
    "clipped_fraction": 0.0,
    "contrast": None,
    "coverage_fraction": 0.31,
    "tilt_deg": 8.0,
    "warnings": [{"code": "flat", "detail": "Nearly flat.", "advice": "Tilt the board by 15° more."}],
}


def subject(points: list[dict[str, Any]] | None = None, **changes: Any) -> OverlaySubject:
    """Return a measurement that waits, but for the changes."""
    measurement = {
        "status": "queued",
        "pose_id": "P1",
        "cycle": None,
        "failure": None,
        "excluded": None,
        "calibration": None,
        "capture_quality": None,
    }
    return OverlaySubject({**measurement, **changes}, points, "chessboard", 25.0)


def test_a_refusal_states_its_code_reason_and_advice() -> None:
    said = statement_of(subject(status="failed", failure=FAILURE, cycle=3), 1.0, is_whole=True)
    assert said.verdict == "refused"
    assert "target_not_found" in said.title
    assert "P1, cycle 3" in said.title
    assert FAILURE["detail"] in said.sentences
    assert any("Show the whole grid." in sentence for sentence in said.sentences)
    assert said.figures == ()


def test_a_refusal_with_points_says_that_these_count() -> None:
    found = {"u_px": 1.0, "v_px": 2.0}
    without, with_points = (
        statement_of(subject(points, status="failed", failure=FAILURE), 1.0, is_whole=True)
        for points in (None, [found])
    )
    assert len(with_points.sentences) == len(without.sentences) + 1


@pytest.mark.parametrize("grade", [None, "determined", "weak"])
def test_a_calibration_states_figures_that_its_document_has(grade: str | None) -> None:
    calibration = CALIBRATION if grade is None else {**CALIBRATION, "grade": grade}
    said = statement_of(
        subject(status="succeeded", calibration=calibration, capture_quality=QUALITY), 1.0, is_whole=True
    )
    assert said.verdict == "measured"
    assert (grade or "Measured") in said.title
    assert sum(WARNING["detail"] in str(sentence) for sentence in said.sentences) == 3
    camera, quality = said.figures
    for figure in ("529.0 ± 9.3", "0.16 px", "(212.1, 33.7, -261.4) mm"):
        assert figure in camera
    for figure in ("edges 2.9 px", "motion 1.2 px at 157°", "white saturated 12%", "tilt 8°"):
        assert figure in quality
    assert "contrast" not in quality
    given = {**CALIBRATION, "standard_uncertainty": {"fx_px": 0.0}}
    said = statement_of(subject(status="succeeded", calibration=given), 1.0, is_whole=True)
    assert "fx 528.97 (given) px" in said.figures[0]


def test_what_waits_is_excluded_dark_or_damaged_says_so() -> None:
    assert statement_of(subject(), 1.0, is_whole=True).verdict == "waiting"
    excluded = subject(excluded={"reason": "hand in view", "by": "key", "at": "2026-01-01T00:00:00Z"})
    assert any("hand in view" in s for s in statement_of(excluded, 1.0, is_whole=True).sentences)
    plain, dark, damaged = (
        statement_of(subject(), brightening, is_whole=whole)
        for brightening, whole in ((1.0, True), (14.0, True), (1.0, False))
    )
    assert (len(plain.figures), len(dark.figures)) == (0, 1)
    assert "14 times" in dark.figures[0]
    assert len(damaged.sentences) == len(plain.sentences) + 1


def test_what_makes_an_image_weak_is_said_first() -> None:
    weak = {
        "code": "focal_weakly_observable",
        "detail": "The focal length is uncertain by 4 %.",
        "advice": None,
    }
    calibration = {**CALIBRATION, "grade": "weak", "warnings": [WARNING] * 3 + [weak]}
    sentences = statement_of(
        subject(status="succeeded", calibration=calibration), 1.0, is_whole=True
    ).sentences
    assert "uncertain by 4 %" in sentences[0]
    assert "1 more warning is in the measurement." in sentences
