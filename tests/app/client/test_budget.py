"""`gridpose sessions budget` prints every figure with its inputs and its check."""

from __future__ import annotations

import pytest

from app.client.commands.sessions.budget import print_budget

INPUT = {
    "figure": "distances.ad_mm",
    "pose_id": "P1",
    "to_pose_id": "P[2]",
    "source": "print_scale",
    "type": "B",
    "distribution": "normal",
    "input_uncertainty": 1e-4,
    "input_unit": "1",
    "sensitivity": 300.0,
    "standard_uncertainty_mm": 0.03,
    "degrees_of_freedom": None,
    "share": 1.0,
}
TOTAL = {
    **{key: INPUT[key] for key in ("figure", "pose_id", "to_pose_id")},
    "value_mm": 0.1,
    "standard_uncertainty_mm": 0.03,
    "degrees_of_freedom": None,
    "coverage_factor": 1.96,
    "expanded_uncertainty_mm": 0.0588,
    "interval_mm": [0.04, 0.16],
    "monte_carlo": {
        "trials": 20000,
        "standard_uncertainty_mm": 0.03,
        "interval_mm": [0.041, 0.159],
        "difference_mm": 0.001,
        "tolerance_mm": 0.005,
        "agrees": True,
    },
}


def test_inputs_totals_and_the_check(capsys: pytest.CaptureFixture[str]) -> None:
    other = {**INPUT, "figure": "repeatability.rp_l_mm", "to_pose_id": None}
    print_budget([INPUT, other], [TOTAL])
    text = capsys.readouterr().out
    assert text.count("AD P1-P[2]") == 3
    assert "RP_l" not in text
    words = " ".join(text.replace("│", " ").split())
    assert "0.0400 to 0.1600" in words  # RP_l and AP are skewed: value ± U is not their interval
    assert "U = 0.059" in words
    assert "±" not in text
    assert "100%" in text
    assert "0.0410 to 0.1590 mm; agrees" in text
    print_budget([], [])
    assert "No figure has a budget" in capsys.readouterr().out
    print_budget([], [{**TOTAL, "figure": "noise_floor.rp_l_mm", "interval_mm": None}])
    assert "0.1000 ± 0.059 mm" in capsys.readouterr().out
