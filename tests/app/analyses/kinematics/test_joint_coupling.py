"""Robots whose joints are coupled: with the coupling stated, everything is as of the same robot without it."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

from tests.support.service.signed_in import signed_in
from tests.support.sessions.kinematics import document, get, make_robot, measured, of_readings, readings
from tests.support.sessions.stored_sessions import new_session
from tests.support.sessions.tracked_robot import send

COUPLING = np.eye(6)
COUPLING[2, 1] = 1.0  # joint 3 of the model turns by its stated angle and that of joint 2
COUPLING[5, 4] = -0.25


@pytest.fixture(scope="module")
def sessions(api: Any) -> tuple[str, str, str]:
    """Sessions of the same readings: of a plain robot, a coupled one, and a coupled one that does not say so."""
    _, poses = measured(1)
    plain = readings(poses)
    inverse = np.linalg.inv(COUPLING)
    stated = [{**one, "joint_angles_deg": (inverse @ one["joint_angles_deg"]).tolist()} for one in plain]
    found = []
    for sent, coupling in ((plain, None), (stated, COUPLING.tolist()), (stated, None)):
        robot = make_robot(api)
        changed = api.client.patch(f"/v1/robots/{robot}", json={"joint_coupling": coupling})
        assert changed.status_code == 200, changed.text
        found.append(new_session(api, robot_id=robot))
        send(api, found[-1], sent)
    return found[0], found[1], found[2]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["global", "cpa", "screw", "combined"])
def test_the_same_robot_is_found(api: Any, sessions: tuple[str, str, str], method: str) -> None:
    plain, coupled, _ = sessions
    expected, found = (document(of_readings(api, one, method=method)) for one in (plain, coupled))
    assert found["joint_coupling"] == COUPLING.tolist()
    assert expected["joint_coupling"] is None
    for one, other in zip(expected["joints"], found["joints"], strict=True):
        for name in ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg"):
            u = other["standard_uncertainty"][name]
            if u is not None:  # rounding of the stated angles, far below what is stated
                assert other[name] == pytest.approx(one[name], abs=0.02 * u)


@pytest.mark.slow
def test_the_page_offers_the_files_that_a_coupled_robot_has(api: Any, sessions: tuple[str, str, str]) -> None:
    query = {"source": "measured_poses"}
    page = api.client.get(
        f"/ui/sessions/{sessions[1]}/robot", params={**query, "compute": "1"}, headers=signed_in(api)
    )
    assert page.status_code == 200
    offered = set(re.findall(r"/robot/files/([a-z.]+)\?", page.text))
    assert {"robot.urdf", "robot.yaml"} <= offered
    assert "robot.csv" not in offered
    for name in offered:
        file = api.client.get(
            f"/ui/sessions/{sessions[1]}/robot/files/{name}", params=query, headers=signed_in(api)
        )
        assert file.status_code == 200, name
        assert ("<mimic" in file.text) == (name == "robot.urdf")


def test_without_the_coupling_nothing_fits(api: Any, sessions: tuple[str, str, str]) -> None:
    answer = get(api, sessions[2], source="measured_poses")
    said = answer.json()
    if answer.status_code == 200:
        assert said["residual"]["position_mm"] > 10.0
        (said,) = [w for w in said["warnings"] if w["code"] == "joint_coupling_proposed"]
    else:
        assert answer.status_code == 409
    assert "--joint-coupling 3:2:1 " in said["advice"]
    assert "--joint-coupling 6:5:-0.25" in said["advice"]
    assert "joint 3 follows joint 2 by 1" in said["detail"]


@pytest.mark.slow
def test_a_changed_coupling_is_another_input(api: Any, sessions: tuple[str, str, str]) -> None:
    coupled = sessions[1]
    before = document(of_readings(api, coupled))
    robot = api.client.get(f"/v1/sessions/{coupled}").json()["robot_id"]
    slightly = COUPLING.copy()
    slightly[2, 1] = 1.0 + math.radians(1e-3)
    api.client.patch(f"/v1/robots/{robot}", json={"joint_coupling": slightly.tolist()})
    after = document(of_readings(api, coupled))
    api.client.patch(f"/v1/robots/{robot}", json={"joint_coupling": COUPLING.tolist()})
    assert after["inputs_sha256"] != before["inputs_sha256"]
    assert document(of_readings(api, coupled))["inputs_sha256"] == before["inputs_sha256"]
