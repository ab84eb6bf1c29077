"""The lens model of a session over HTTP: chosen, overridden, stated with its evidence, or refused."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from app.api.schemas.analyses import IntrinsicsAnalysis
from core.geometry import LENS_PARAMETERS, LensModel, compose, invert
from tests.support.sessions.repeatability import T_BASE_TARGET, T_FLANGE_CAMERA, command
from tests.support.sessions.stored_sessions import Shot, Store, body, codes, new_session, problem, shoot
from tests.support.simulation.wide_lenses import BOARD, WideSession, draw_session


def shots_of(session: WideSession) -> list[Shot]:
    pairs = zip(session.views, session.T_camera_target, strict=True)
    return [Shot(f"P{k + 1}", 1, points, invert(T)) for k, (points, T) in enumerate(pairs)]


def stored(api: Any, store: Store, drawn: WideSession) -> str:
    session = new_session(api, BOARD)
    store(api, session, shots_of(drawn))
    return session


@pytest.fixture
def wide(api: Any, store: Store) -> tuple[str, WideSession]:
    drawn = draw_session(np.random.default_rng(4), "kannala_brandt", images=10)
    return stored(api, store, drawn), drawn


def get(api: Any, session: str, analysis: str = "intrinsics", **query: Any) -> Any:
    return api.client.get(f"/v1/sessions/{session}/{analysis}", params=query)


def test_a_wide_lens_gets_its_model_and_the_answer_says_so(api: Any, wide: tuple[str, WideSession]) -> None:
    session, drawn = wide
    document = body(get(api, session))
    IntrinsicsAnalysis.model_validate(document, extra="forbid")
    (group,) = document["groups"]
    assert group["lens_model"] == "kannala_brandt"
    assert group["lens_evidence"]["statistic"] > 30.0
    assert group["lens_evidence"]["share"] > 0.03
    assert group["lens_evidence"]["held_out"]["rms_ratio"] < 0.95
    assert "lens_beyond_brown" in codes(document)
    found = {**group["intrinsics"], **group["distortion"]}
    names = LENS_PARAMETERS["kannala_brandt"]
    u = group["standard_uncertainty"]
    assert tuple(found) == tuple(u) == names
    covariance = np.array(group["covariance"])
    assert np.sqrt(np.diag(covariance)) == pytest.approx([u[name] for name in names], rel=1e-3)
    for name in ("fx_px", "fy_px", "cx_px", "cy_px"):
        assert abs(found[name] - getattr(drawn.camera, name)) < 4.0 * u[name], name
    assert 300.0 < group["observed_radius_px"] < 800.0
    # Its coefficients are no camera of `given`, which is Brown's: k1, k2 and k3 would mean something else there.
    stated = api.client.patch(f"/v1/sessions/{session}", json={"intrinsics": found})
    assert stated.status_code == 422


def test_images_of_one_place_take_browns_model_with_a_sentence(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(poses=1, cycles=6))
    document = body(get(api, session))
    assert document["groups"][0]["lens_model"] == "brown"
    assert document["groups"][0]["lens_evidence"] is None
    assert "lens_not_examined" in codes(document)
    assert "lens_not_examined" not in codes(body(get(api, session, lens_model="brown")))


def test_a_plain_lens_keeps_browns_model(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(poses=6, cycles=2))
    document = body(get(api, session))
    (group,) = document["groups"]
    assert group["lens_model"] == "brown"
    assert group["lens_evidence"]["share"] < 0.03
    assert list(group["distortion"]) == ["k1", "k2", "p1", "p2", "k3"]
    assert group["fold_radius_px"] is None or group["fold_radius_px"] > group["observed_radius_px"]
    assert "lens_beyond_brown" not in codes(document)


@pytest.mark.parametrize("model", ["brown", "rational"])
def test_a_model_can_be_asked_for(api: Any, store: Store, model: LensModel) -> None:
    session = stored(api, store, draw_session(np.random.default_rng(8), "kannala_brandt", images=10))
    document = body(get(api, session, lens_model=model))
    (group,) = document["groups"]
    assert group["lens_model"] == model
    assert len(group["covariance"]) == len(LENS_PARAMETERS[model])
    assert group["lens_evidence"]["statistic"] > 30.0
    assert ("lens_beyond_brown" in codes(document)) == (model == "brown")


@pytest.mark.slow
def test_every_pooled_analysis_takes_the_model(api: Any, wide: tuple[str, WideSession]) -> None:
    """The camera's poses are those of the true lens, within what is stated."""
    session, drawn = wide
    document = body(get(api, session, "camera-poses"))
    assert "lens_beyond_brown" in codes(document)
    assert len(document["camera_poses"]) == 10
    distances = []
    for one, T in zip(document["camera_poses"], drawn.T_camera_target, strict=True):
        assert one["used"]
        off = np.array(one["pose"]["position_mm"]) - invert(T)[:3, 3]
        distances.append(off @ np.linalg.solve(np.array(one["pose"]["covariance"])[:3, :3], off))
    assert np.mean(distances) < 12.0  # three degrees of freedom, the lens's share of them common to all
    for analysis in ("repeatability", "comparison"):
        assert "lens_beyond_brown" in codes(body(get(api, session, analysis))), analysis


def test_hand_eye_takes_the_model(api: Any, wide: tuple[str, WideSession]) -> None:
    """Camera on the flange and target in the base are the true ones within five of their stated uncertainties."""
    session, drawn = wide
    commanded = {
        f"P{k + 1}": compose(T_BASE_TARGET, invert(T), invert(T_FLANGE_CAMERA))
        for k, T in enumerate(drawn.T_camera_target)
    }
    command(api, session, commanded)
    document = body(get(api, session, "hand-eye"))
    assert "lens_beyond_brown" in codes(document)
    (target,) = document["base_targets"]
    for frame, true in ((document["flange_camera"], T_FLANGE_CAMERA), (target, T_BASE_TARGET)):
        u = np.array([frame["standard_uncertainty"][axis] for axis in ("x_mm", "y_mm", "z_mm")])
        assert np.all(np.abs(np.array(frame["position_mm"]) - true[:3, 3]) < 5.0 * u)
        assert np.all(u < 1.0)


@pytest.mark.slow
def test_each_image_has_its_own_focal_length_before_the_sessions_lens(
    api: Any, wide: tuple[str, WideSession]
) -> None:
    session, drawn = wide
    document = body(get(api, session, "camera-poses", estimator="per_image_session_prior"))
    assert "lens_beyond_brown" in codes(document)
    f = 0.5 * (drawn.camera.fx_px + drawn.camera.fy_px)
    for one in document["camera_poses"]:
        assert one["used"]
        assert abs(one["focal"]["focal_px"] - f) < 4.5 * one["focal"]["standard_uncertainty_px"]
    pooled = body(get(api, session, "camera-poses"))
    assert all(one["focal"] is None for one in pooled["camera_poses"])
    (group,) = body(get(api, session, estimator="per_image_session_prior"))["groups"]
    assert group["lens_model"] == "kannala_brandt"


def test_the_targets_shape_is_refined_before_the_model(api: Any, wide: tuple[str, WideSession]) -> None:
    session, drawn = wide
    (group,) = body(get(api, session, refine_target="true"))["groups"]
    assert group["lens_model"] == "kannala_brandt"
    found, u = group["intrinsics"]["fx_px"], group["standard_uncertainty"]["fx_px"]
    assert abs(found - drawn.camera.fx_px) < 5.0 * u


def test_what_takes_browns_model_alone_refuses_another(api: Any, wide: tuple[str, WideSession]) -> None:
    session, _ = wide
    problem(get(api, session, estimator="per_image", lens_model="rational"), 409, "invalid_argument")
    assert get(api, session, lens_model="fisheye").status_code == 422


@pytest.mark.slow
def test_the_plot_shows_what_each_model_leaves_over(api: Any, wide: tuple[str, WideSession]) -> None:
    session, _ = wide
    (group,) = body(get(api, session))["groups"]
    response = get(api, session, "intrinsics/lens.svg")
    assert response.status_code == 200, response.text
    described = ElementTree.fromstring(response.content).findtext("{http://www.w3.org/2000/svg}desc")
    assert described is not None
    assert "default: Kannala-Brandt lens model, 10 images" in described
    assert f"points reach {group['observed_radius_px']:.0f} px" in described
    assert f"w {group['lens_evidence']['statistic']:.0f}," in described
    rms = {name: float(described.split(f"{name}: ")[1].split(" ")[0]) for name in ("Brown", "Kannala-Brandt")}
    assert rms["Brown"] > 1.5 * rms["Kannala-Brandt"]
