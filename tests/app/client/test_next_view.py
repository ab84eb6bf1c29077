"""`gridpose sessions next-view` prints each view as a camera's user sees it."""

from __future__ import annotations

import pytest

from app.client.commands.sessions.next_view import print_views


def test_a_view_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    view = {
        "view_distance_mm": 412.3,
        "view_tilt_deg": 43.2,
        "target_middle_px": [640.2, 380.0],
        "expected_uncertainty_now": {"projection_rms_px": 1.5},
        "expected_uncertainty_after": {"projection_rms_px": 1.02},
    }
    print_views({"suggestions": [view, view]})
    text = " ".join(capsys.readouterr().out.split())
    assert "1. 412 mm away, tilted 43°, the target's middle at (640, 380) px: 1.50 -> 1.02 px" in text
    assert "2. 412 mm away" in text
