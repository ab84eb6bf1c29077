"""The camera of a session over HTTP: the truth within what is stated, and every refusal in words."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import numpy as np
import pytest

from app.analyses.inputs.snapshot_reader import read_snapshot
from app.analyses.service import entity_tag
from app.api.schemas.analyses import IntrinsicsAnalysis
from core.geometry.camera import CAMERA_PARAMETERS
from core.geometry.se3 import compose, invert, so3_exp, so3_log, transform
from core.targets.specification import TargetSpec
from tests.support.sessions.cameras import get
from tests.support.sessions.stored_sessions import (
    BOARD,
    CAMERA,
    WIDTH,
    Store,
    assert_order_is_irrelevant,
    body,
    look,
    new_session,
    problem,
    shoot,
    with_fields,
)


@pytest.mark.parametrize("estimator", ["pooled", "pooled_free_focal"])
def test_the_camera_is_found_within_its_stated_uncertainty(api: Any, store: Store, estimator: str) -> None:
    session = new_session(api)
    ids = store(api, session, shoot(cycles=6))
    document = body(get(api, session, estimator=estimator))
    IntrinsicsAnalysis.model_validate(document, extra="forbid")
    (group,) = document["groups"]
    assert (group["focus_group"], group["image_count"], document["pending"]) == ("default", 30, 0)
    found = {**group["intrinsics"], **group["distortion"]}
    for name in CAMERA_PARAMETERS[:8]:
        u = group["standard_uncertainty"][name]
        assert u > 0
        assert abs(found[name] - getattr(CAMERA, name)) < 4.0 * u, name
    assert found["k3"] == group["standard_uncertainty"]["k3"] == 0.0
    covariance = np.array(group["covariance"])
    assert covariance.shape == (9, 9)
    assert np.sqrt(np.diag(covariance)) == pytest.approx(
        list(group["standard_uncertainty"].values()), rel=1e-3
    )
    # χ² of 30 images of 54 points: a standard deviation of .026.
    assert group["reduced_chi2"] == pytest.approx(1.0, abs=0.1)
    assert len(group["highest_residuals"]) == 5
    assert {worst["measurement_id"] for worst in group["highest_residuals"]} <= set(ids)
    assert document["warnings"] == document["target_transforms"] == []
    seen, cells = group["residual_map"], group["residual_map"]["mean_residuals"]
    assert len(cells) == seen["cells"]
    assert sum(cell["beyond_chance"] for cell in cells) == seen["cells_beyond_chance"]
    assert 0.9 * seen["point_count"] < sum(cell["point_count"] for cell in cells) <= seen["point_count"]
    squares = sum(cell["point_count"] * cell["rms_px"] ** 2 for cell in cells)
    assert squares / seen["point_count"] == pytest.approx(seen["rms_px"] ** 2, rel=0.1)
    rings = group["radial_residuals"]
    assert len(rings) > 12
    assert all(ring["radius_px"] < group["observed_radius_px"] for ring in rings)
    # The lens is the model's: 24 means within four of their uncertainties, but for one in 600 sessions.
    assert all(abs(ring["mean_px"]) < 4.0 * ring["standard_uncertainty_px"] for ring in rings)


def test_estimators_that_share_nothing_report_the_mean_camera(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(cycles=3))
    (group,) = body(get(api, session, estimator="per_image"))["groups"]
    assert group["intrinsics"]["fx_px"] == pytest.approx(
        CAMERA.fx_px, abs=4 * group["standard_uncertainty"]["fx_px"]
    )
    (group,) = body(get(api, session, estimator="per_image_fixed_pp"))["groups"]
    assert group["intrinsics"]["cx_px"] == 0.5 * (WIDTH - 1)
    assert group["intrinsics"]["fx_px"] == group["intrinsics"]["fy_px"] != 0
    assert group["standard_uncertainty"]["cx_px"] == group["distortion"]["p1"] == 0


def test_given_intrinsics_are_reported_as_given(api: Any, store: Store) -> None:
    intrinsics = dataclasses.asdict(CAMERA)
    session = new_session(api, intrinsics=intrinsics)
    store(api, session, shoot(cycles=2))
    document = body(get(api, session, estimator="given"))
    (group,) = document["groups"]
    assert {**group["intrinsics"], **group["distortion"]} == intrinsics
    assert set(group["standard_uncertainty"].values()) == {0.0}
    assert document["warnings"] == []
    # Given ones that are wrong are called so.
    wrong = {**intrinsics, "fx_px": 1.02 * intrinsics["fx_px"], "fy_px": 1.02 * intrinsics["fy_px"]}
    assert api.client.patch(f"/v1/sessions/{session}", json={"intrinsics": wrong}).status_code == 200
    (warning,) = body(get(api, session, estimator="given"))["warnings"]
    assert warning["code"] == "intrinsics_vary_between_images"
    assert warning["detail"].startswith("The session's intrinsics do not explain")
    assert "estimator=pooled," in warning["advice"]


def test_the_order_of_uploads_never_matters(api: Any, store: Store) -> None:
    shots = [*shoot(cycles=3), *with_fields(shoot(seed=7, cycles=1), focus_group="other")]
    for i in (1, 5):
        shots[i] = dataclasses.replace(shots[i], cycle=None)
    assert_order_is_irrelevant(api, store, shots, partial(get, api))


def test_an_answer_the_client_has_is_not_sent_again(api: Any, store: Store) -> None:
    session = new_session(api)
    shots = shoot(cycles=2)
    store(api, session, shots[:-2])
    url = f"/v1/sessions/{session}/intrinsics"
    first = api.client.get(url)
    tag = first.headers["ETag"]
    assert api.client.get(url).content == first.content
    strong = tag.removeprefix("W/")
    for known in (tag, f'"x", {tag}', f"W/{strong}", strong, "*"):
        again = api.client.get(url, headers={"If-None-Match": known})
        assert (again.status_code, again.content, again.headers["ETag"]) == (304, b"", tag)
    assert api.client.get(url, headers={"If-None-Match": '"x"'}).content == first.content
    for lines in (['"x"', tag, '"y"'], [tag, '"x"']):  # several header lines are one list
        headers = [("If-None-Match", line) for line in lines]
        assert api.client.get(url, headers=headers).status_code == 304
    assert get(api, session, estimator="per_image").headers["ETag"] != tag
    # An image that waits changes what is said of it, though not what is computed; one more that is measured does both.
    store(api, session, with_fields(shots[-2:-1], status="queued"))
    waiting = api.client.get(url, headers={"If-None-Match": tag})
    assert body(waiting) == {**body(first), "pending": 1}
    store(api, session, shots[-1:])
    more = body(api.client.get(url, headers={"If-None-Match": waiting.headers["ETag"]}))
    assert more["inputs_sha256"] != body(first)["inputs_sha256"]
    assert more["groups"][0]["image_count"] == 9


def test_the_inputs_differ_with_all_that_enters(
    api: Any, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    shots = shoot(cycles=1)
    variants = {
        "as it is": (shots, {}),
        "another cycle": ([dataclasses.replace(shots[0], cycle=2), *shots[1:]], {}),
        "another focus group": ([*with_fields(shots[:1], focus_group="x"), *shots[1:]], {}),
        "joint angles": ([*with_fields(shots[:1], joint_angles_deg=[1.0]), *shots[1:]], {}),
        "a lens": (shots, {"lens": {"focal_length_mm": 8.0, "pixel_pitch_um": 6.9}}),
    }
    hashes = {}
    for name, (stored, fields) in variants.items():
        session = new_session(api, **fields)
        store(api, session, stored)
        hashes[name] = body(get(api, session))["inputs_sha256"]
    session = new_session(api, dataclasses.replace(BOARD, pitch_mm=12.5))
    store(api, session, shots)
    hashes["another pitch"] = body(get(api, session))["inputs_sha256"]
    assert len(set(hashes.values())) == len(hashes)
    session = new_session(api)
    store(api, session, with_fields(shots, captured_at=None, filename="a.png"))
    assert body(get(api, session))["inputs_sha256"] == hashes["as it is"]
    tag = get(api, session).headers["ETag"]
    monkeypatch.setattr("app.analyses.inputs.snapshot.core_version", lambda: "9.9.9")
    with api.installation.database.read() as records:
        snapshot = read_snapshot(records, session)
    inputs_sha256 = snapshot.inputs_sha256("intrinsics", {"estimator": "pooled"})
    assert entity_tag(snapshot.answer_sha256(inputs_sha256)) != tag


def test_two_targets_in_one_image_are_tied(api: Any, store: Store) -> None:
    second = TargetSpec("chessboard", 8, 5, 10.0)
    T_first_second = transform(so3_exp(np.array([0.1, -0.3, 0.2])), np.array([30.0, 10.0, 4.0]))
    session = new_session(api, BOARD, second)
    first_id, second_id = api.client.get(f"/v1/sessions/{session}").json()["target_ids"]
    shots = shoot(cycles=2)
    rng = np.random.default_rng(11)
    store(api, session, shots, first_id)
    both = [
        dataclasses.replace(
            shot,
            points=look(rng, compose(invert(shot.T_target_camera), T_first_second), board=second),
            fields={"sha256": shot.sha256},
        )
        for shot in shots[:5]
    ]
    store(api, session, both, second_id)
    document = body(get(api, session))
    (tie,) = document["target_transforms"]
    assert (tie["from_target_id"], tie["to_target_id"], tie["image_count"]) == (first_id, second_id, 5)
    found, u = np.array(tie["T_from_to"]), np.sqrt(np.diag(tie["covariance"]))
    assert np.all(np.abs(found[:3, 3] - T_first_second[:3, 3]) < 4.0 * u[:3])
    assert np.all(np.abs(so3_log(found[:3, :3] @ T_first_second[:3, :3].T)) < 4.0 * u[3:])
    assert np.all(u[:3] < 0.1)


def test_bad_input_is_refused_with_advice(api: Any, store: Store) -> None:
    session = new_session(api)
    assert "no images" in problem(get(api, session), 409, "too_few_measurements")["detail"]
    store(api, session, with_fields(shoot(cycles=1), status="queued"))
    waiting = problem(get(api, session), 409, "too_few_measurements")
    assert "5 are waiting" in waiting["detail"]
    assert waiting["advice"]
    session = new_session(api)
    store(api, session, [dataclasses.replace(shot, points=None) for shot in shoot(cycles=1)])
    nothing = problem(get(api, session), 409, "no_usable_images")
    assert "target_not_found (5)" in nothing["detail"]
    problem(get(api, session, estimator="given"), 409, "intrinsics_missing")
    problem(get(api, session, estimator="best"), 422, "invalid_request")
    problem(get(api, "ses_" + "0" * 26), 404, "session_not_found")
    problem(api.client.post(f"/v1/sessions/{session}/intrinsics"), 405, "method_not_allowed")
    headers = {"Authorization": "Bearer gp_x_y"}
    problem(api.client.get(f"/v1/sessions/{session}/intrinsics", headers=headers), 401, "not_authenticated")
