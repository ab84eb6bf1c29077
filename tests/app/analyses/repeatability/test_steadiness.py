"""Steadiness over HTTP: of images whose camera's mount moves, and of poses that another instrument measured."""

from __future__ import annotations

import dataclasses
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from core.geometry.se3 import compose, invert, transform
from tests.support.sessions.repeatability import body, get, table
from tests.support.sessions.stored_sessions import Store, look, new_session, shoot


def _with_step(shots: list[Any], step_mm: float) -> list[Any]:
    """Return the shots with the camera moved along z of the target from the 13th cycle on."""
    rng = np.random.default_rng(4)
    moved = transform(np.eye(3), np.array([0.0, 0.0, step_mm]))
    return [
        dataclasses.replace(shot, points=look(rng, invert(compose(moved, shot.T_target_camera))))
        if (shot.cycle or 0) > 12
        else shot
        for shot in shots
    ]


@pytest.mark.slow
def test_a_moving_mount_is_reported_and_drawn(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, _with_step(shoot(seed=3, cycles=24), 0.4))
    document = table(api, session)
    assert {row["verdict"] for row in document["poses"]} == {"not_steady"}
    found = document["steadiness"]
    assert found["steady"] is False
    assert found["p_values"]["overall_p_value"] <= 0.01
    assert found["common_motion"]["attribution"] == "common"
    assert found["change_point"]["cycle"] == 13
    assert found["change_point"]["step_mm"] == pytest.approx([0.0, 0.0, 0.4], abs=0.1)
    assert [row["pose_id"] for row in found["poses"]] == ["P1", "P2", "P3", "P4", "P5"]
    assert "not_steady" in [warning["code"] for warning in document["warnings"]]
    path = f"/v1/sessions/{session}/repeatability/steadiness.svg"
    drawn = api.client.get(path)
    assert drawn.status_code == 200
    assert drawn.headers["etag"]
    namespace = "{http://www.w3.org/2000/svg}"
    said = ElementTree.fromstring(drawn.content).findtext(f"{namespace}desc") or ""
    assert said.startswith("not steady: the poses move together")
    assert "largest step" in said
    assert "P5" in said
    one = ElementTree.fromstring(api.client.get(path, params={"pose_id": "P2"}).content)
    only = one.findtext(f"{namespace}desc") or ""
    assert "P2" in only
    assert "P5" not in only
    tables = api.client.get(
        f"/v1/sessions/{session}/repeatability",
        params={"table": "steadiness.poses"},
        headers={"Accept": "text/csv"},
    )
    assert tables.text.splitlines()[0].startswith("pose_id,steady,p_value,change_x_mm")
    assert len(tables.text.splitlines()) == 6


@pytest.mark.slow
def test_a_session_at_rest_is_steady_and_few_cycles_are_not_tested(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(seed=3, cycles=12))
    found = body(get(api, session))["steadiness"]
    assert found["steady"] is True
    assert found["common_motion"] is None
    assert found["effective_cycles"] == pytest.approx(12.0, abs=0.5)
    few = new_session(api)
    store(api, few, shoot(seed=4, cycles=4))
    document = body(get(api, few))
    assert document["steadiness"]["steady"] is None
    assert document["steadiness"]["p_values"] is None
    assert document["steadiness"]["poses"] == []
    assert "steadiness_not_tested" in [warning["code"] for warning in document["warnings"]]
    refused = api.client.get(f"/v1/sessions/{few}/repeatability/steadiness.svg")
    assert refused.status_code == 409
    assert refused.json()["code"] == "too_few_cycles"
