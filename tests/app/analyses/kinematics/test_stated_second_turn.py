"""Robots that state β: identifications are compared with them in their form, and hashes know of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from app.cli.demo.session import joint_rows
from core.simulation.arm import KR5_ARC
from tests.support.service.signed_in import signed_in
from tests.support.sessions.kinematics import (
    document,
    get,
    make_robot,
    measured,
    of_readings,
    readings,
)
from tests.support.sessions.stored_sessions import new_session
from tests.support.sessions.tracked_robot import send


def test_the_nominal_s_second_turn_is_compared_and_hashed(api: Any) -> None:
    _, poses = measured(1)
    robot = make_robot(api)
    session = new_session(api, robot_id=robot)
    send(api, session, readings(poses))

    def found(beta_deg: float | None, *, stated: bool = True) -> dict[str, Any]:
        joints: list[dict[str, Any]] = [*joint_rows(KR5_ARC)]
        if stated:
            joints[1] = {**joints[1], "beta_deg": beta_deg}
        changed = api.client.patch(f"/v1/robots/{robot}", json={"joints": joints})
        assert changed.status_code == 200, changed.text
        assert changed.json()["joints"][1]["beta_deg"] == (beta_deg if stated else None)
        return document(of_readings(api, session, model="dh"))

    plain, zero, tilted = found(None, stated=False), found(0.0), found(0.05)
    assert [joint["nominal"]["beta_deg"] for joint in plain["joints"]] == [None] * 6
    assert plain["inputs_sha256"] == zero["inputs_sha256"] != tilted["inputs_sha256"]
    assert [joint["nominal"]["beta_deg"] for joint in tilted["joints"]] == [
        None,
        pytest.approx(0.05),
        *[None] * 4,
    ]
    # The same poses: the same arm, whatever it is compared with.
    for one, other in zip(plain["joints"], tilted["joints"], strict=True):
        for name in ("a_mm", "alpha_deg", "d_mm", "beta_deg"):
            assert other[name] == pytest.approx(one[name], abs=1e-5)
    # The robot with β is off the poses by what the tilt does to it.
    errors = [one["validation"]["nominal"]["position_rms_mm"] for one in (plain, tilted)]
    assert abs(errors[1] - errors[0]) > 0.01
    page = api.client.get(f"/ui/robots/{robot}", headers=signed_in(api)).text
    assert "β, °" in page
    assert ">0.05<" in page
    images = get(api, session)
    assert images.status_code == 409


def test_a_robot_that_is_the_arm_has_nothing_to_differ_from(api: Any) -> None:
    arm, poses = measured(2, free=30)
    truth = arm.chain.as_array()
    joints: list[dict[str, Any]] = joint_rows(arm.chain)
    joints[1]["beta_deg"] = math.degrees(truth[1, 4])
    made = api.client.post("/v1/robots", json={"name": "as built", "joints": joints})
    assert made.status_code == 201, made.text
    session = new_session(api, robot_id=made.json()["id"])
    send(api, session, readings(poses))
    found = document(of_readings(api, session, model="dh"))
    second = found["joints"][1]
    assert second["parallel_to_next"]
    off = np.array(
        [
            (second[name] - second["nominal"][name]) / second["standard_uncertainty"][name]
            for name in ("a_mm", "beta_deg")
        ]
    )
    assert np.abs(off).max() < 4.5
