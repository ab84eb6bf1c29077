"""Which images a session's camera is estimated from: of one size, focus and camera, and enough of them."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from core.geometry.se3 import invert
from tests.support.sessions.cameras import get
from tests.support.sessions.stored_sessions import (
    BOARD,
    CAMERA,
    HEIGHT,
    WIDTH,
    Shot,
    Store,
    body,
    draw_board_pose,
    look,
    new_session,
    problem,
    shoot,
)
from tests.support.simulation.simulated_views import draw_pose


def test_views_that_one_image_is_refused_for_count_in_the_pool(api: Any, store: Store) -> None:
    rng = np.random.default_rng(5)
    flat = []
    for i in range(6):
        T = draw_board_pose(rng, 1.0)
        flat.append(Shot(f"F{i}", 1, look(rng, T), invert(T)))
    session = new_session(api)
    store(api, session, [*shoot(cycles=1), *flat])
    refused = api.client.get(f"/v1/sessions/{session}/measurements", params={"status": "failed"}).json()[
        "items"
    ]
    assert {m["failure"]["code"] for m in refused} == {"focal_not_observable"}
    assert body(get(api, session))["groups"][0]["image_count"] == 5 + len(flat)
    document = body(get(api, session, estimator="per_image"))
    assert document["groups"][0]["image_count"] == 5 + len(flat) - len(refused)
    (warning,) = document["warnings"]
    assert warning["code"] == "images_excluded"
    assert all(m["id"] in warning["detail"] for m in refused[:5])


def test_a_focus_that_changed_is_detected_and_named(api: Any, store: Store) -> None:
    shots = shoot(poses=8, cycles=4)
    zoomed = dataclasses.replace(CAMERA, fx_px=1.004 * CAMERA.fx_px, fy_px=1.004 * CAMERA.fy_px)
    rng = np.random.default_rng(2)
    changed = [
        dataclasses.replace(shot, points=look(rng, invert(shot.T_target_camera), camera=zoomed))
        if shot.pose_id == "P3"
        else shot
        for shot in shots
    ]
    session = new_session(api)
    ids = store(api, session, changed)
    document = body(get(api, session))
    (warning,) = document["warnings"]
    assert warning["code"] == "intrinsics_vary_between_images"
    assert document["groups"][0]["reduced_chi2"] > 1.3
    of_pose = {one for one, shot in zip(ids, changed, strict=True) if shot.pose_id == "P3"}
    assert {worst["measurement_id"] for worst in document["groups"][0]["highest_residuals"][:4]} == of_pose
    # In focus groups of their own each camera is sound.
    session = new_session(api)
    store(
        api,
        session,
        [
            dataclasses.replace(s, fields={"focus_group": s.pose_id[:1] + str(s.pose_id == "P3")})
            for s in changed
        ],
    )
    document = body(get(api, session))
    assert [(g["focus_group"], g["image_count"]) for g in document["groups"]] == [
        ("PFalse", 28),
        ("PTrue", 4),
    ]
    # Four images of one place say nothing of the lens model, and do not separate the focal length from a bent print.
    assert {warning["code"] for warning in document["warnings"]} == {
        "lens_not_examined",
        "focal_weakly_observable",
    }
    assert all("'PTrue'" in warning["detail"] for warning in document["warnings"])
    assert [g["grade"] for g in document["groups"]] == ["determined", "weak"]
    assert document["groups"][0]["intrinsics"]["fx_px"] == pytest.approx(CAMERA.fx_px, rel=5e-4)


def test_an_image_of_another_camera_is_excluded_and_named(api: Any, store: Store) -> None:
    rng = np.random.default_rng(2)
    other = dataclasses.replace(CAMERA, fx_px=1.2 * CAMERA.fx_px, fy_px=1.2 * CAMERA.fy_px)
    T = draw_pose(rng, BOARD, other, WIDTH, math.radians(40.0))
    session = new_session(api)
    ids = store(api, session, [*shoot(cycles=4), Shot("P9", 1, look(rng, T, camera=other), invert(T))])
    document = body(get(api, session))
    assert document["groups"][0]["image_count"] == 20
    (warning,) = document["warnings"]
    assert warning["code"] == "images_excluded"
    assert ids[-1] in warning["detail"]
    assert document["groups"][0]["intrinsics"]["fx_px"] == pytest.approx(CAMERA.fx_px, rel=5e-4)


def test_flat_views_alone_do_not_make_a_focal_length(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(cycles=2, tilt_deg=0.2, sigma_px=0.1))
    refused = problem(get(api, session), 409, "focal_not_observable")
    assert "tilt" in refused["advice"]


def test_sizes_of_images_do_not_mix(api: Any, store: Store) -> None:
    shots = shoot(cycles=2)
    small = [
        dataclasses.replace(
            s, points=dataclasses.replace(s.points, image_width_px=1300, image_height_px=HEIGHT)
        )
        for s in shots
        if s.points is not None
    ]
    session = new_session(api)
    ids = store(api, session, [*small[:2], *shots[2:]])
    document = body(get(api, session))
    assert document["groups"][0]["image_count"] == 8
    assert [w["code"] for w in document["warnings"]] == ["image_size_differs", "images_excluded"]
    assert all(one in document["warnings"][1]["detail"] for one in ids[:2])
    session = new_session(api)
    store(api, session, [*small[:5], *shots[5:]])
    assert "1300 x 1024 (5)" in problem(get(api, session), 409, "mixed_image_sizes")["detail"]


def test_a_weak_camera_is_answered_with_its_grade_and_no_figure_of_a_robot(api: Any, store: Store) -> None:
    """Two noisy views at 8° leave the focal length uncertain by 3 %, each by itself by 12 %."""
    session = new_session(api)
    store(api, session, shoot(cycles=1, tilt_deg=8.0, sigma_px=0.3)[:2])
    found = body(get(api, session))
    assert "focal_weakly_observable" in {warning["code"] for warning in found["warnings"]}
    (group,) = found["groups"]
    assert group["grade"] == "weak"
    low, high = group["interval_95"]["fx_px"]
    u = group["standard_uncertainty"]["fx_px"]
    f = group["intrinsics"]["fx_px"]
    assert 0.02 < u / f < 0.15
    assert 0.0 < f - low < high - f
    assert low < CAMERA.fx_px < high
    for estimator in ("pooled", "per_image"):
        parameters = {"estimator": estimator}
        poses = body(api.client.get(f"/v1/sessions/{session}/camera-poses", params=parameters))
        assert [one["pose"] is not None for one in poses["camera_poses"]] == [True, True], estimator
    for analysis in ("repeatability", "hand-eye"):
        problem(api.client.get(f"/v1/sessions/{session}/{analysis}"), 409, "focal_not_observable")
