"""Whether two values of a figure differ is a matter of its uncertainty, which a report states next to it."""

from __future__ import annotations

from typing import Any

import pytest

from app.analyses.reporting.figure_uncertainty import standard_uncertainty
from app.analyses.reporting.verification import _differences, _severity
from app.reports.forms import figures_of

DOCUMENT: dict[str, Any] = {
    "poses": [
        {
            "pose_id": "P1",
            "repeatability": {"rp_l_mm": 0.1},
            "interval": {"rp_l_mm": [0.08, 0.16]},
            "corrected": {"rp_l_mm": 0.09},
            "corrected_interval": {"rp_l_mm": [0.07, 0.15]},
            "noise_floor": {"rp_l_mm": 0.02},
            "accuracy": {"ap_p_mm": 0.3, "interval": {"ap_p_mm": [0.2, 0.4]}, "held_out": {"ap_p_mm": 0.31}},
        }
    ],
    "groups": [{"intrinsics": {"fx_px": 650.0}, "standard_uncertainty": {"fx_px": 0.02}}],
    "distances": [
        {
            "from_pose_id": "P1",
            "to_pose_id": "P2",
            "mean_mm": 400.0,
            "standard_uncertainty_mm": 0.01,
            "ad_mm": 0.1,
            "ad_interval_mm": [0.0, 0.2],
            "rd_mm": 0.05,
            "interval_mm": [0.04, 0.08],
        }
    ],
    "drift": {"shift_mm": [0.1, 0.2], "shift_standard_uncertainty_mm": [0.01, 0.03]},
    "verdict": "robot",
}
FIGURES = figures_of(DOCUMENT, "a")


@pytest.mark.parametrize(
    ("name", "uncertainty"),
    [
        ("a.poses[P1].repeatability.rp_l_mm", 0.02),
        ("a.poses[P1].interval.rp_l_mm[2]", 0.02),
        ("a.poses[P1].corrected.rp_l_mm", 0.02),
        ("a.poses[P1].noise_floor.rp_l_mm", None),
        ("a.poses[P1].accuracy.ap_p_mm", 0.05),
        ("a.poses[P1].accuracy.held_out.ap_p_mm", 0.05),
        ("a.groups[1].intrinsics.fx_px", 0.02),
        ("a.groups[1].standard_uncertainty.fx_px", 0.02),
        ("a.distances[P1 to P2].mean_mm", 0.01),
        ("a.distances[P1 to P2].ad_mm", 0.05),
        ("a.distances[P1 to P2].rd_mm", 0.01),
        ("a.drift.shift_mm[2]", 0.03),
        ("a.verdict", None),
    ],
)
def test_the_uncertainty_of_a_figure_stands_next_to_it(name: str, uncertainty: float | None) -> None:
    assert name in FIGURES
    found = standard_uncertainty(FIGURES, name)
    assert found == (None if uncertainty is None else pytest.approx(uncertainty))


def test_differences_are_stated_in_uncertainties_the_gravest_first() -> None:
    now = FIGURES | {
        "a.poses[P1].repeatability.rp_l_mm": 0.102,
        "a.poses[P1].noise_floor.rp_l_mm": 0.0201,
        "a.groups[1].intrinsics.fx_px": 650.03,
        "a.verdict": "too_few_cycles",
    }
    found = sorted(_differences(FIGURES, now), key=_severity, reverse=True)
    assert [one["path"].rpartition(".")[2] for one in found] == ["verdict", "fx_px", "rp_l_mm", "rp_l_mm"]
    assert [one["in_uncertainties"] for one in found] == [None, pytest.approx(1.5), pytest.approx(0.1), None]
