"""Camera poses and hand-eye calibration through the interface."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from core.geometry.se3 import invert
from tests.support.sessions.repeatability import T_BASE_TARGET, T_FLANGE_CAMERA, command, deviating_robot
from tests.support.sessions.stored_sessions import Shot, Store, new_session

AXES = ("x_mm", "y_mm", "z_mm")


@pytest.fixture(scope="module")
def robot() -> tuple[list[Shot], dict[str, Any]]:
    """Images of ten poses in two cycles, and what was commanded."""
    shots, commanded, _ = deviating_robot(31, 10, 0.2)
    return [shot for shot in shots if shot.cycle in (1, 2)], commanded


def get(api: Any, session: str, analysis: str, status: int = 200, **query: str) -> dict[str, Any]:
    response = api.client.get(f"/v1/sessions/{session}/{analysis}", params=query)
    assert response.status_code == status, response.text
    document: dict[str, Any] = response.json()
    return document


def test_the_camera_is_found_on_the_flange_and_the_target_in_the_base(
    api: Any, store: Store, robot: tuple[list[Shot], dict[str, Any]]
) -> None:
    shots, commanded = robot
    session = new_session(api)
    store(api, session, shots)
    assert get(api, session, "hand-eye", 409)["code"] == "commanded_poses_missing"
    command(api, session, commanded)
    document = get(api, session, "hand-eye")
    (target,) = document["base_targets"]
    frames = (
        (document["flange_camera"], "T_flange_camera", T_FLANGE_CAMERA),
        (target, "T_base_target", T_BASE_TARGET),
    )
    for frame, name, true in frames:
        T = np.array(frame[name])
        assert T.shape == (4, 4)
        u = [frame["standard_uncertainty"][axis] for axis in AXES]
        assert np.all(np.abs(np.array(frame["position_mm"]) - T[:3, 3]) < 1e-3 * np.array(u))
        np.testing.assert_allclose(u, np.sqrt(np.diag(frame["covariance"])[:3]), rtol=1e-3)
        # Five standard uncertainties: one session of one seed.
        assert np.all(np.abs(T[:3, 3] - true[:3, 3]) < 5.0 * np.array(u))
    assert target["pose_count"] == len(document["residuals"]) == 10
    assert [row["pose_id"] for row in document["residuals"]] == [f"P{k}" for k in range(1, 11)]
    assert document["validation"]["position_rms_mm"] > document["residual"]["position_rms_mm"]
    assert document["excluded_poses"] == []
    assert get(api, session, "hand-eye") == document


def test_every_image_with_points_has_a_pose_or_a_reason(
    api: Any, store: Store, robot: tuple[list[Shot], dict[str, Any]]
) -> None:
    shots, _ = robot
    session = new_session(api)
    odd = shots[-1]
    assert odd.points is not None
    other_size = dataclasses.replace(odd.points, image_width_px=3000)
    nothing = Shot("P90", 1, None, odd.T_target_camera)
    ids = store(api, session, [*shots[:-1], dataclasses.replace(odd, points=other_size), nothing])
    rows = {row["measurement_id"]: row for row in get(api, session, "camera-poses")["camera_poses"]}
    assert set(rows) == set(ids[:-1])
    for shot, name in zip(shots[:-1], ids, strict=False):
        row = rows[name]
        assert (row["pose_id"], row["cycle"], row["used"], row["rejection"]) == (
            shot.pose_id,
            shot.cycle,
            True,
            None,
        )
        u = np.array([row["pose"]["standard_uncertainty"][axis] for axis in AXES])
        assert np.all(np.abs(row["pose"]["position_mm"] - shot.T_target_camera[:3, 3]) < 6.0 * u)
        # Each is rounded to what its own uncertainty supports.
        np.testing.assert_allclose(
            invert(np.array(row["T_camera_target"]))[:3, 3], row["pose"]["position_mm"], atol=1e-6
        )
        assert np.all(np.diag(row["pose"]["covariance"]) >= np.diag(row["pose"]["covariance_given_camera"]))
        assert row["rms_px"] < 0.1
    refused = rows[ids[-2]]
    assert (refused["used"], refused["pose"], refused["rejection"]["code"]) == (
        False,
        None,
        "image_size_differs",
    )
    assert get(api, session, "camera-poses", 422, estimator="best")["code"] == "invalid_request"
