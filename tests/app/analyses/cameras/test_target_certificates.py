"""Certificates and prints of targets over HTTP: stored, changed, refused, and used by analyses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.support.sessions.repeatability import command, deviating_robot, table
from tests.support.sessions.stored_sessions import Store, codes, new_session

CERTIFICATE = {
    "number": "4711",
    "laboratory": "Laboratory",
    "issued_on": "2026-03-14",
    "pitch_x_mm": 10.01,
    "pitch_y_mm": 10.01,
    "standard_uncertainty": {"pitch_x_mm": 0.001, "pitch_y_mm": 0.001, "squareness_mrad": 0.05},
}


def test_a_certificate_is_stored_changed_and_taken_away(api: Any) -> None:
    target_id = api.make_target(pitch_mm=10.0, certificate=CERTIFICATE, print_kind="glass")
    path = f"/v1/targets/{target_id}"
    stored = api.client.get(path).json()
    assert stored["certificate"]["pitch_x_mm"] == 10.01
    assert stored["certificate"]["issued_on"] == "2026-03-14"
    assert stored["print_kind"] == "glass"
    changed = api.client.patch(
        path, json={"certificate": None, "shape_standard_uncertainty": {"bow_mm": 0.3}}
    )
    assert changed.status_code == 200, changed.text
    assert changed.json()["certificate"] is None
    assert changed.json()["shape_standard_uncertainty"]["bow_mm"] == 0.3
    assert changed.json()["print_kind"] == "glass"
    changed = api.client.patch(path, json={"pitch_standard_uncertainty_mm": 0.002})
    assert changed.status_code == 200, changed.text
    assert changed.json()["pitch_standard_uncertainty_mm"] == 0.002
    assert changed.json()["name"] == stored["name"]


@pytest.mark.parametrize(
    "change",
    [
        {"certificate": {**CERTIFICATE, "pitch_x_mm": 254.0}},
        {"certificate": {"points_mm": [[0, 0, 0]], "points_standard_uncertainty_mm": 0.001}},
        {"certificate": {"pitch_x_mm": 10.0, "pitch_y_mm": 10.0}},
        {"print_kind": "stone"},
        {"shape_standard_uncertainty": {"bow_mm": -1.0}},
        {"pitch_mm": 12.0},
        {"pitch_standard_uncertainty_mm": -0.1},
        {"pitch_standard_uncertainty_mm": 2.0},
    ],
)
def test_what_cannot_be_is_refused_and_changes_nothing(api: Any, change: dict[str, Any]) -> None:
    target_id = api.make_target(pitch_mm=10.0)
    response = api.client.patch(f"/v1/targets/{target_id}", json=change)
    assert response.status_code == 422, response.text
    stored = api.client.get(f"/v1/targets/{target_id}").json()
    assert stored["certificate"] is stored["print_kind"] is stored["shape_standard_uncertainty"] is None


def test_a_certified_pitch_scales_what_analyses_measure(api: Any, store: Store) -> None:
    shots, commanded, _ = deviating_robot(31, 5, 0.2)
    session = new_session(api)
    store(api, session, shots)
    command(api, session, commanded)
    target_id = api.client.get(f"/v1/sessions/{session}").json()["target_ids"][0]
    pitch = api.client.get(f"/v1/targets/{target_id}").json()["pitch_mm"]
    before = table(api, session)
    assert "scale_taken_as_exact" in codes(before)
    path = f"/v1/targets/{target_id}"
    assert api.client.patch(path, json={"pitch_standard_uncertainty_mm": 0.001}).status_code == 200
    stated = table(api, session)
    assert "scale_taken_as_exact" not in codes(stated)
    assert all(one["accuracy"]["interval"] is not None for one in stated["poses"] if one["accuracy"])
    assert api.client.patch(path, json={"pitch_standard_uncertainty_mm": None}).status_code == 200
    certificate = {**CERTIFICATE, "pitch_x_mm": 1.001 * pitch, "pitch_y_mm": 1.001 * pitch}
    response = api.client.patch(f"/v1/targets/{target_id}", json={"certificate": certificate})
    assert response.status_code == 200, response.text
    after = table(api, session)
    assert "scale_taken_as_exact" not in codes(after)
    ratio = [
        b["mean_mm"] / a["mean_mm"] for a, b in zip(before["distances"], after["distances"], strict=True)
    ]
    np.testing.assert_allclose(ratio, 1.001, atol=1e-4)
    assert all(one["standard_uncertainty_mm"] > 5e-5 * one["mean_mm"] for one in after["distances"])
