"""`gridpose sessions joint-noise` prints the joints, the validation, predictions and the worst place."""

from __future__ import annotations

import pytest

from app.client.commands.sessions.joint_noise import print_joint_noise

PREDICTED = {"joint_angles_deg": [0.0, -65.0], "rp_l_mm": 0.0512, "interval_mm": [0.045, 0.058]}
FOUND = {
    "joint_noise": [
        {"joint": 1, "sigma_deg": 0.0042, "interval_deg": [0.0038, 0.0047]},
        {"joint": 2, "sigma_deg": None, "interval_deg": None},
    ],
    "scatter_validation": {
        "scatter_ratio": 1.02,
        "log_likelihood_gain": 41.3,
        "log_likelihood_gain_standard_error": 9.04,
    },
    "predictions": [PREDICTED],
    "worst_place": {**PREDICTED, "rp_l_mm": 0.3, "position_mm": [400.0, 1359.0, 455.0]},
    "warnings": [{"detail": "Joint [2] is not seen.", "advice": "Measure orientation, too."}],
}


def test_joints_validation_predictions_and_the_worst_place(capsys: pytest.CaptureFixture[str]) -> None:
    print_joint_noise(FOUND)
    text = capsys.readouterr().out
    assert "0.0038 to 0.0047" in text
    assert "not observable" in text
    assert "1.02 times as predicted" in text
    assert "+41.3 ± 9.0 over" in text
    assert "at 0.0, -65.0°: RP_l 0.0512 mm (0.0450 to 0.0580)" in text
    assert "worst place (400, 1359, 455) mm" in text
    assert "Joint [2] is not seen. Measure orientation, too." in text
