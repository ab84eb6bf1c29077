"""Qualifications over time: those of one camera make a chart, the worst error by its size."""

from __future__ import annotations

import numpy as np

from app.analyses.documents.qualification import control_document
from app.analyses.history import charted_tests, entries_of_qualifications
from tests.support.sessions.filed_reports import FIRST


def test_qualifications_of_one_camera_make_a_chart() -> None:
    rows = [
        {
            **{
                "id": f"qua_{k:026d}",
                "session_id": f"ses_{k:026d}",
                "session_name": "bar",
                "robot_id": "rob_1",
            },
            **{"camera_name": "A" if k < 6 else None, "made_at": FIRST.replace(day=k + 1)},
            **{"worst_error_mm": -0.01 + 0.001 * (k % 3), "scale_ppm": 5.0, "probing_scatter_mm": None},
        }
        for k in range(8)
    ]
    first, second = charted_tests(entries_of_qualifications(rows), [])
    assert ([first.reports[0].source, len(first.reports)], len(second.reports)) == (["A", 6], 2)
    assert set(first.charts) == {("qualification", "worst error"), ("qualification", "scale")}


def test_the_worst_error_is_charted_by_its_size() -> None:
    """One length is 20 µm too long and one too short, to half a micrometre: which is worst is chance."""
    rng = np.random.default_rng(3)
    errors = np.array([0.02, -0.02]) + rng.normal(0.0, 0.0005, (24, 2))
    worst = [float(one[np.argmax(np.abs(one))]) for one in errors]
    assert min(worst) < 0.0 < max(worst)
    rows = [
        {
            **{"id": f"qua_{k:026d}", "session_id": "ses_1", "session_name": "bar", "robot_id": "rob_1"},
            **{"camera_name": "A", "made_at": FIRST.replace(day=k + 1)},
            **{"worst_error_mm": value, "scale_ppm": None, "probing_scatter_mm": None},
        }
        for k, value in enumerate(worst)
    ]
    (test,) = charted_tests(entries_of_qualifications(rows), [])
    chart = test.charts["qualification", "worst error"]
    assert (chart.alarm, chart.outside) == (None, ())
    larger = control_document("worst_error_mm", worst, -0.03)
    assert larger is not None
    assert not larger["in_control"]
