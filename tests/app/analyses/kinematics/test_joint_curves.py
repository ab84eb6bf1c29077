"""Joint curves over HTTP: the plot, the level with its reasons, and refusals where no curve was fitted."""

from __future__ import annotations

import re
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.support.sessions.kinematics import document, make_robot, of_readings, readings
from tests.support.sessions.stored_sessions import new_session, problem
from tests.support.sessions.tracked_robot import send
from tests.support.simulation.robots.real_arms import angles_within_limits, measured, real_arm

DESCRIPTION = "{http://www.w3.org/2000/svg}desc"


def curves(api: Any, session: str, **query: Any) -> Any:
    query = {"source": "measured_poses", **query}
    return api.client.get(f"/v1/sessions/{session}/dh/joint-curves.svg", params=query)


@pytest.fixture
def session(api: Any) -> str:
    """An arm with gears and compliance, joint 1 away from -20° to 20°."""
    rng = np.random.default_rng(3)
    q = angles_within_limits(rng, 80)
    q = q[np.abs(np.degrees(q[:, 0])) > 20.0]
    session = new_session(api, robot_id=make_robot(api))
    send(api, session, readings(measured(real_arm(rng), q, rng)))
    return session


@pytest.mark.slow
def test_the_plot_says_what_the_answer_says(api: Any, session: str) -> None:
    found = document(of_readings(api, session))
    level = found["level"]
    assert level["chosen"] == "all"
    assert level["configurations"] < 80
    assert level["all_evidence"] > max(10.0, level["compliance_evidence"])
    assert level["held_out_ratio"] == found["error_model"]["held_out_ratio"] < 0.5
    assert f"{level['held_out_ratio']:.2f} of the chain's error" in level["gain"]
    assert f"{level['configurations']} configurations" in level["reason"]

    response = curves(api, session)
    assert response.status_code == 200, response.text
    assert response.headers["content-type"] == "image/svg+xml"
    drawn = ElementTree.fromstring(response.content)
    title = str(drawn.findtext(DESCRIPTION.replace("desc", "title")))
    assert re.search(r" · robot .+ · session of \d{4}-\d{2}-\d{2}$", title)
    described = drawn.findtext(DESCRIPTION)
    assert described is not None
    summary, *joints = described.splitlines()
    assert summary == level["gain"]
    assert [line.split(":")[0] for line in joints] == [f"joint {k}" for k in range(1, 7)]
    gaps = found["region"]["joints"][0]["gaps"]
    assert any(gap["minimum_deg"] <= -20.0 and gap["maximum_deg"] >= 20.0 for gap in gaps)
    unvisited = joints[0].split("not visited: ")[1].replace("−", "-")
    for gap in gaps[:2]:
        assert f"{gap['minimum_deg']:.0f}° to {gap['maximum_deg']:.0f}°" in unvisited
    for line, curve in zip(joints, found["error_model"]["joint_curves"], strict=True):
        largest = 1e3 * max(curve["correction_deg"], key=abs)
        shown = line.split("correction ")[1].split(" ")[0].replace("−", "-")
        rounding = 0.51 * 10.0 ** -len(shown.partition(".")[2])
        assert float(shown) == pytest.approx(largest, abs=rounding)


def test_a_model_without_curves_is_refused_in_words(api: Any, session: str) -> None:
    assert document(of_readings(api, session, model="dh"))["level"] is None
    refused = problem(curves(api, session, model="dh"), 409, "no_joint_curves")
    assert "model=extended" in refused["advice"]
