"""Joint noise over HTTP: what is found, where repeatability is worst, the map, and refusals with their codes."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
import pytest

from app.api.schemas.analyses import JointNoiseAnalysis
from app.cli.demo.session import joint_rows
from core.simulation.arm import KR5_ARC, KR5_ARC_LIMITS
from tests.support.sessions.kinematics import make_robot, readings
from tests.support.sessions.stored_sessions import body, new_session, problem
from tests.support.sessions.tracked_robot import send
from tests.support.simulation.robots.repeated_poses import JOINT_SIGMA, repeated_poses

POSES, VISITS = 8, 8


def sent(visits: int = VISITS) -> list[dict[str, Any]]:
    _, data, _ = repeated_poses(21, poses=POSES, visits=visits)
    rows = readings(data)
    return [{**row, "cycle": i % visits + 1} for i, row in enumerate(rows)]


def ask(api: Any, session: str, path: str = "", **query: Any) -> Any:
    return api.client.get(
        f"/v1/sessions/{session}/joint-noise{path}", params={"source": "measured_poses", **query}
    )


@pytest.fixture(scope="module")
def session(api: Any) -> str:
    robot = make_robot(api)
    limits = np.degrees(np.asarray(KR5_ARC_LIMITS)).reshape(-1, 2 if np.shape(KR5_ARC_LIMITS)[1] == 2 else 6)
    pairs = limits if limits.shape[1] == 2 else limits.T
    joints = [
        {**row, "minimum_deg": low, "maximum_deg": high}
        for row, (low, high) in zip(joint_rows(KR5_ARC), pairs.tolist(), strict=True)
    ]
    assert api.client.patch(f"/v1/robots/{robot}", json={"joints": joints}).status_code == 200
    made: str = new_session(api, robot_id=robot)
    send(api, made, sent())
    return made


def test_noise_prediction_and_worst_place(api: Any, session: str) -> None:
    angles = ["0,-65,75,10,55,0", "20,-40,60,0,45,90"]
    found = body(ask(api, session, at=angles))
    JointNoiseAnalysis.model_validate(found, extra="forbid")
    assert [one["joint"] for one in found["joint_noise"]] == [1, 2, 3, 4, 5, 6]
    for one, true in zip(found["joint_noise"], np.degrees(JOINT_SIGMA).tolist(), strict=True):
        low, high = one["interval_deg"]
        assert low <= one["sigma_deg"] <= high
        assert 0.4 * true < one["sigma_deg"] < 2.0 * true
    assert found["remaining_scatter"]["instrument_stated"] is True
    assert found["scatter_validation"]["supported"] is True
    assert [(one["pose_id"], one["visits"]) for one in found["poses"]] == [
        (f"P{i}", VISITS) for i in range(POSES)
    ]
    assert [one["joint_angles_deg"] for one in found["predictions"]] == [
        [float(part) for part in text.split(",")] for text in angles
    ]
    for one in (*found["predictions"], *found["poses"]):
        low, high = one["interval_mm"]
        assert 0.0 < low < one["rp_l_mm"] < high
        assert one["ellipsoid"]["sigma_mm"] == sorted(one["ellipsoid"]["sigma_mm"], reverse=True)
    assert found["limits_stated"] == [True] * 6
    worst = found["worst_place"]
    cells = found["repeatability_map"]["repeatability_cells"]
    assert worst["rp_l_mm"] >= max(cell["largest_rp_l_mm"] for cell in cells)
    assert math.hypot(*worst["position_mm"][:2]) > 100.0
    rows = api.client.get(
        f"/v1/sessions/{session}/joint-noise",
        params={"source": "measured_poses", "table": "joint_noise"},
        headers={"Accept": "text/csv"},
    )
    assert rows.status_code == 200
    assert len(rows.text.splitlines()) == 7


def test_an_instrument_that_states_more_than_all_scatter_leaves_no_noise(api: Any) -> None:
    made: str = new_session(api, robot_id=make_robot(api))
    send(
        api,
        made,
        [{**row, "covariance": (1e4 * np.array(row["covariance"])).tolist()} for row in sent()],
    )
    found = body(ask(api, made, at=["0,-65,75,10,55,0"]))
    JointNoiseAnalysis.model_validate(found, extra="forbid")
    for one in found["joint_noise"]:
        assert one["sigma_deg"] == one["interval_deg"][0] == 0.0
        assert 0.0 < one["interval_deg"][1] < 1.0
    (predicted,) = found["predictions"]
    assert predicted["rp_l_mm"] == pytest.approx(0.0, abs=1e-5)
    assert 0.0 < predicted["standard_uncertainty_mm"] < predicted["interval_mm"][1] < 10.0
    assert {one["code"] for one in found["warnings"]} >= {"joint_noise_not_supported", "joint_noise_size_off"}
    assert ask(api, made, "/map.svg").status_code == 200


def test_the_map_is_drawn(api: Any, session: str) -> None:
    response = ask(api, session, "/map.svg")
    assert response.status_code == 200, response.text
    root = ET.fromstring(response.content)
    title = str(root.findtext("{http://www.w3.org/2000/svg}title"))
    assert re.search(r" · robot .+ · session of \d{4}-\d{2}-\d{2}$", title)
    description = root.find("{http://www.w3.org/2000/svg}desc")
    assert description is not None
    assert "Worst place" in str(description.text)


def test_what_cannot_be_estimated_is_refused(api: Any, session: str) -> None:
    for wrong in ("0,1,x", "", "nan,0,0,0,0,0"):
        found = problem(ask(api, session, at=wrong), 422, "invalid_request")
        assert found["errors"][0]["field"] == "at"
    problem(ask(api, session, at="0,0,0"), 409, "joint_angles_inconsistent")
    alone = new_session(api)
    send(api, alone, sent(2))
    assert problem(ask(api, alone), 409, "nominal_robot_missing")["advice"]
    once = new_session(api, robot_id=make_robot(api))
    send(api, once, sent(1))
    assert problem(ask(api, once), 409, "too_few_poses")["advice"]
    assert api.client.get("/v1/sessions/ses_nothing/joint-noise").status_code == 404
