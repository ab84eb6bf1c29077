"""Readings that are almost surely in another unit are refused with the guess, unless the client insists."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.support.sessions.stored_sessions import new_session

INSIST = {"accept_implausible": "true"}


CUBE = 150.0 * np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 1, 1]]) + [500.0, -100.0, 600.0]


def visits(places: np.ndarray, sigma: float, cycles: int = 5, scale: float = 1.0) -> list[dict[str, Any]]:
    rng = np.random.default_rng(3)
    return [
        {
            "pose_id": f"P{i + 1}",
            "cycle": cycle + 1,
            "position_mm": (scale * (place + sigma * rng.standard_normal(3))).tolist(),
        }
        for cycle in range(cycles)
        for i, place in enumerate(places)
    ]


def send_commands(api: Any, session: str, places: np.ndarray) -> None:
    poses = [{"pose_id": f"P{i + 1}", "position_mm": place.tolist()} for i, place in enumerate(places)]
    assert api.client.post(f"/v1/sessions/{session}/poses", json=poses).status_code == 200


@pytest.mark.parametrize(
    ("commanded", "scale", "guess"),
    [(True, 1e-3, "metres"), (False, 1e-3, "metres"), (True, 1e3, "micrometres")],
)
def test_readings_in_metres_are_refused(api: Any, commanded: bool, scale: float, guess: str) -> None:
    session = new_session(api)
    if commanded:
        send_commands(api, session, CUBE)
    sent = visits(CUBE, 0.1, scale=scale)
    path = f"/v1/sessions/{session}/measured-poses"
    refused = api.client.post(path, json=sent)
    assert (refused.status_code, refused.json()["code"]) == (422, "implausible_unit")
    assert guess in refused.json()["detail"]
    assert refused.json()["errors"][0]["field"] == "0.position_mm"
    assert "accept_implausible" in refused.json()["advice"]
    assert api.client.get(path).json()["items"] == []
    assert api.client.post(path, json=sent, params=INSIST).status_code == 200
    # What is stored is stored: sent again, it is what it was.
    assert api.client.post(path, json=sent).status_code == 200


@pytest.mark.parametrize(
    ("places", "sigma", "commanded"),
    [
        (CUBE, 0.1, True),
        (CUBE, 0.001, False),
        (np.zeros((1, 3)), 0.0005, True),  # one pose in a local frame
        (0.5 * np.eye(3), 0.02, False),  # deviations about local origins, pose by pose
        (0.5 * np.eye(3), 0.02, True),
        (0.2 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]) + 1000.0, 0.0005, False),  # a tool about one point
        (CUBE * [1.0, 1.0, 0.01] + [3000.0, 0.0, 0.0], 2.0, True),  # a poor robot
    ],
)
def test_readings_that_may_be_are_stored(api: Any, places: np.ndarray, sigma: float, commanded: bool) -> None:
    session = new_session(api)
    if commanded:
        send_commands(api, session, CUBE)
    stored = api.client.post(f"/v1/sessions/{session}/measured-poses", json=visits(places, sigma))
    assert stored.status_code == 200, stored.json()
