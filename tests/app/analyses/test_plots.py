"""Plots over HTTP: drawn outside the head from stored data, distinguished by their tags, refused in words."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.support.sessions.stored_sessions import Shot, Store, body, new_session, problem, shoot, with_fields

SPACE = "{http://www.w3.org/2000/svg}"
PLOTS = (
    "repeatability/scatter.svg",
    "repeatability/drift.svg",
    "intrinsics/residuals.svg",
    "intrinsics/projection-uncertainty.svg",
)


def get(api: Any, session: str, plot: str, **query: Any) -> Any:
    return api.client.get(f"/v1/sessions/{session}/{plot}", params=query)


def described(response: Any) -> list[str]:
    """The lines of a drawing's description, once it is seen to be one whose title names session and date."""
    assert response.status_code == 200, response.text
    assert response.headers["content-type"] == "image/svg+xml"
    root = ElementTree.fromstring(response.content)
    assert root.tag == f"{SPACE}svg"
    assert re.search(r" · session of \d{4}-\d{2}-\d{2}$", str(root.findtext(f"{SPACE}title")))
    description = root.findtext(f"{SPACE}desc")
    assert description is not None
    return description.splitlines()


@pytest.fixture(scope="module")
def ordinary() -> list[Shot]:
    return shoot(3, poses=3, cycles=20)


@pytest.mark.slow
def test_plots_say_what_the_tables_say(api: Any, store: Store, ordinary: list[Shot]) -> None:
    session = new_session(api)
    blind = Shot("P2", 21, None, ordinary[0].T_target_camera)
    store(api, session, [*ordinary, blind])
    rows = body(api.client.get(f"/v1/sessions/{session}/repeatability"))["poses"]
    answer = get(api, session, PLOTS[0])
    assert "Accept" in answer.headers["vary"]
    lines = described(answer)
    assert len(lines) == len(rows) == 3
    for row, line in zip(rows, lines, strict=True):
        assert line.startswith(f"{row['pose_id']}: n = {row['cycles']} ")
        assert f"verdict: {row['verdict'].replace('_', ' ')}" in line
        reading, floor = row["repeatability"]["rp_l_mm"], row["noise_floor"]["rp_l_mm"]
        assert float(line.split("RP_l = ")[1].split(" ")[0]) == pytest.approx(reading, rel=5e-3)
        assert float(line.split("noise floor ")[1].split(" ")[0]) == pytest.approx(floor, rel=5e-2)
    assert described(get(api, session, PLOTS[0], pose_id="P2")) == lines[1:2]
    moved = described(get(api, session, PLOTS[1]))
    assert [line.split(":")[0] for line in moved] == ["P1", "P2", "P3"]
    assert all("n = 20" in line and "standard errors" in line for line in moved)
    drifts = body(api.client.get(f"/v1/sessions/{session}/repeatability"))["drift"]["poses"]
    for drift, line in zip(drifts, moved, strict=True):
        unit = 1e3 if " µm (" in line else 1.0
        shift, errors = line.split("x, y, z: ")[1].split(" (standard errors ")
        shown = [float(text) / unit for text in shift.replace("−", "-").rsplit(" ", 1)[0].split(", ")]
        uncertainties = [float(text) / unit for text in errors.rstrip(")").split(", ")]
        distance = float(line.split("moved ")[1].split(" ")[0]) / unit
        rounding = 0.6 * 10.0 ** -len(errors.split(",")[0].partition(".")[2]) / unit
        assert shown == pytest.approx(drift["shift_mm"], abs=rounding)
        assert uncertainties == pytest.approx(drift["shift_standard_uncertainty_mm"], abs=rounding)
        assert distance == pytest.approx(drift["shift_distance_mm"], abs=rounding)
    (residuals,) = described(get(api, session, PLOTS[2]))
    (group,) = body(api.client.get(f"/v1/sessions/{session}/intrinsics"))["groups"]
    figures = group["residual_map"]
    assert f"{figures['point_count']:,} points" in residuals
    assert f"rms {figures['rms_px']:.3g} px" in residuals
    assert f"{figures['cells_beyond_chance']} of {figures['cells']} cells" in residuals
    assert f"(chance alone: {figures['cells_by_chance']:.1f})" in residuals
    assert f"have an rms of {figures['mean_rms_px']:.2g} px" in residuals
    assert residuals.startswith("Focus group default   ·   60 images   ·   ")
    # Noise of .02 px in u and in v.
    assert float(residuals.split("rms ")[1].split(" ")[0]) == pytest.approx(0.02 * 2**0.5, rel=0.05)


def test_the_projection_map_says_where_the_camera_is_certain(
    api: Any, store: Store, ordinary: list[Shot]
) -> None:
    session = new_session(api)
    store(api, session, ordinary[:12])
    (line,) = described(get(api, session, PLOTS[3]))
    (group,) = body(api.client.get(f"/v1/sessions/{session}/intrinsics"))["groups"]
    found = group["projection_uncertainty"]
    counts = np.array(found["cell_point_counts"])
    values = np.array(found["cell_standard_uncertainties_px"], dtype=float)  # null is NaN
    assert counts.shape == values.shape
    assert counts.sum() == sum(area["point_count"] for area in found["areas"]) == 12 * 54
    assert found["covered_share"] == pytest.approx(np.mean(counts > 0), rel=1e-5)
    assert f"points in {100 * found['covered_share']:.0f} % of the image" in line
    blank = ", ".join(found["blank_areas"]) or "no part of the image"
    assert f"blank: {blank if len(found['blank_areas']) < 9 else 'every part of the image'}   ·" in line
    assert found["blank_areas"] == [a["name"] for a in found["areas"] if a["blank_share"] >= 0.5]
    assert found["largest_covered_px"] == np.nanmax(values[counts > 0])
    assert found["largest_blank_px"] == np.nanmax(values[counts == 0])
    assert f"{found['largest_covered_px']:.2g} px where there are points" in line
    assert 0.0 < np.nanmin(values) < found["largest_covered_px"] < found["largest_blank_px"]
    centre = next(area for area in found["areas"] if area["name"] == "centre")
    # A turned camera and a principal point that is off project in the same way: far less than u(cx) remains.
    assert centre["standard_uncertainty_px"] < 0.5 * group["standard_uncertainty"]["cx_px"]


@pytest.mark.slow
@pytest.mark.parametrize("plot", PLOTS)
def test_a_plot_is_known_by_its_tag(api: Any, store: Store, ordinary: list[Shot], plot: str) -> None:
    first = new_session(api)
    store(api, first, ordinary[:6])
    drawn = get(api, first, plot)
    tag = drawn.headers["etag"]
    again = api.client.get(f"/v1/sessions/{first}/{plot}", headers={"If-None-Match": tag})
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
    by_another = get(api, first, plot, estimator="per_image_fixed_pp")
    assert by_another.headers["etag"] != tag
    assert by_another.content != drawn.content
    assert b"per_image" not in by_another.content, "an estimator has the name that pages give it"
    assert api.client.head(f"/v1/sessions/{first}/{plot}").headers["etag"] == tag
    store(api, first, ordinary[6:9])
    assert get(api, first, plot).headers["etag"] != tag


def test_a_plot_names_session_robot_and_date(api: Any, store: Store, ordinary: list[Shot]) -> None:
    """Two sessions of the same images have plots of their own, and a new name draws and tags anew."""
    joint = {"a_mm": 180.0, "alpha_deg": -90.0, "d_mm": 400.0}
    robot = api.client.post("/v1/robots", json={"name": "KR <5>", "joints": [joint] * 6}).json()["id"]
    sessions = [new_session(api, name="Cell 4", robot_id=robot), new_session(api, name="Cell 5")]
    for session in sessions:
        store(api, session, ordinary[:4])
    drawn = [get(api, session, PLOTS[0]) for session in sessions]
    titles = [ElementTree.fromstring(one.content)[0].text or "" for one in drawn]
    assert re.search(r": Cell 4 · robot KR <5> · session of \d{4}-\d{2}-\d{2}$", titles[0])
    assert "(pooled)" in titles[0]
    assert re.search(r": Cell 5 · session of \d{4}-\d{2}-\d{2}$", titles[1])
    assert drawn[0].headers["etag"] != drawn[1].headers["etag"]
    assert api.client.patch(f"/v1/sessions/{sessions[1]}", json={"name": "Cell 6"}).status_code == 200
    renamed = api.client.get(
        f"/v1/sessions/{sessions[1]}/{PLOTS[0]}", headers={"If-None-Match": drawn[1].headers["etag"]}
    )
    assert renamed.status_code == 200
    assert b"Cell 6" in renamed.content


def test_groups_are_drawn_apart_or_one_alone(api: Any, store: Store, ordinary: list[Shot]) -> None:
    session = new_session(api)
    near, far = (
        with_fields(ordinary[:9], focus_group="near"),
        with_fields(ordinary[9:18], focus_group="far $x$"),
    )
    store(api, session, [*near, *far])
    lines = described(get(api, session, PLOTS[2]))
    assert [line.split("   ")[0] for line in lines] == ["Focus group far $x$", "Focus group near"]
    assert described(get(api, session, PLOTS[2], focus_group="near")) == lines[1:]
    problem(get(api, session, PLOTS[2], focus_group="elsewhere"), 404, "focus_group_not_found")


@pytest.mark.parametrize("plot", PLOTS)
def test_what_cannot_be_drawn_is_said(api: Any, store: Store, ordinary: list[Shot], plot: str) -> None:
    problem(get(api, "ses_nowhere", plot), 404, "session_not_found")
    session = new_session(api)
    assert problem(get(api, session, plot), 409, "too_few_measurements")["advice"]
    problem(get(api, session, plot, estimator="best"), 422, "invalid_request")
    problem(get(api, session, plot, estimator="given"), 409, "too_few_measurements")
    store(api, session, [Shot("P1", cycle, None, ordinary[0].T_target_camera) for cycle in (1, 2)])
    assert problem(get(api, session, plot), 409, "no_usable_images")["advice"]


def test_poses_that_have_nothing_to_show(api: Any, store: Store, ordinary: list[Shot]) -> None:
    session = new_session(api)
    once = [shot for shot in ordinary if shot.cycle == 1]
    blind = Shot("P9", 1, None, ordinary[0].T_target_camera)
    store(api, session, [*once, blind])
    api.client.put(f"/v1/sessions/{session}/poses/P10", json={})
    lines = described(get(api, session, PLOTS[0]))
    assert lines[0] == "P1: n = 1   ·   repeatability needs two cycles"
    assert lines[3] == "P9: n = 0   ·   no image counts: target not found (1)"
    assert problem(get(api, session, PLOTS[1]), 409, "too_few_cycles")["advice"]
    for plot in PLOTS[:2]:
        problem(get(api, session, plot, pose_id="P9"), 409, "no_usable_images")
        problem(get(api, session, plot, pose_id="P10"), 409, "too_few_measurements")
        problem(get(api, session, plot, pose_id="P11"), 404, "pose_not_found")
        problem(get(api, session, plot, pose_id="../P1"), 422, "invalid_request")


def test_what_another_instrument_measured_is_drawn_too(api: Any, store: Store) -> None:
    session = new_session(api)
    rng = np.random.default_rng(8)
    readings = [
        {
            "pose_id": pose_id,
            "cycle": cycle,
            "position_mm": rng.normal((1000.0 * place, 5.0, -3.0), 0.02).tolist(),
            "covariance": np.diag([1e-4] * 3 + [1e-10] * 3).tolist() if pose_id == "P1" else None,
        }
        for cycle in range(1, 25)
        for place, pose_id in enumerate(("P1", "P2"))
    ]
    stored = api.client.post(f"/v1/sessions/{session}/measured-poses", json=readings)
    assert stored.status_code in (200, 201), stored.text
    with_noise, without = described(get(api, session, PLOTS[0], source="measured_poses"))
    assert "noise floor" in with_noise
    assert "noise floor" not in without
    title = ElementTree.fromstring(get(api, session, PLOTS[0], source="measured_poses").content)[0].text
    assert title is not None
    assert "instrument's frame" in title
    moved = described(get(api, session, PLOTS[1], source="measured_poses", pose_id="P2"))
    assert len(moved) == 1
    assert "standard errors" in moved[0]
    problem(get(api, session, PLOTS[0]), 409, "too_few_measurements")
    problem(get(api, new_session(api), PLOTS[1], source="measured_poses"), 409, "measured_poses_missing")


@pytest.mark.slow
def test_too_many_poses_for_one_plot(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(5, poses=41, cycles=2))
    for plot in PLOTS[:2]:
        refused = problem(get(api, session, plot), 409, "too_many_for_plot")
        assert "pose_id" in refused["advice"]
        assert described(get(api, session, plot, pose_id="P41"))[0].startswith("P41: n = 2")


@pytest.mark.slow
def test_the_head_never_loads_what_draws() -> None:
    """Plots are drawn in another process; the head stays small."""
    program = (
        "import sys, app.main, app.analyses.service\n"
        "from app.settings import Settings\n"
        "from pathlib import Path\n"
        "app.main.create_app(Settings(data_dir=Path('/nonexistent/gridpose'))).openapi()\n"
        "print([m for m in ('matplotlib', 'PIL', 'app.analyses.documents.plots.drawing') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "[]"
