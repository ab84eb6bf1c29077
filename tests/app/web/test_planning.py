"""Pages that plan: a test's cube, a robot's identification, a camera's next views, and what its image lacks."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from app.analyses.outcome import AnalysisRefused
from app.cli.demo.session import joint_rows
from app.web.pages import environment
from app.web.words import fixed, number
from core.simulation.arm import KR5_ARC
from tests.app.web.test_pages import signed_in
from tests.support.service.service import ApiMaker
from tests.support.sessions.kinematics import make_robot, readings
from tests.support.sessions.robot_session import store_robot_session
from tests.support.sessions.stored_sessions import body, new_session, shoot, store_shots
from tests.support.sessions.tracked_robot import send
from tests.support.simulation.robots.repeated_poses import repeated_poses

CUBE = {"side_mm": 200, "centre_mm": "900, 0, 450", "cycles": 10, "limit_mm": "1"}
HOME = "0, -90, 90, 0, 45, 0"


@pytest.fixture(scope="module")
def api(open_api: ApiMaker) -> Iterator[Any]:
    """One application for all tests here, each with sessions of its own: its process takes seconds to start."""
    with open_api() as running:
        yield running


@pytest.fixture(scope="module")
def target(api: Any) -> str:
    made: str = api.make_target(kind="chessboard", columns=14, rows=10, pitch_mm=20.0)
    return made


def page(api: Any, address: str, status: int = 200, **query: Any) -> str:
    response = api.client.get(f"/ui/{address}", params=query, headers=signed_in(api))
    assert response.status_code == status, response.text
    return html.unescape(response.text)


def test_what_cannot_be_planned_is_said_in_words(api: Any, target: str) -> None:
    empty = page(api, "plans/iso9283")
    assert 'name="centre_mm"' in empty
    assert "What the session will show" not in empty
    for wrong, said in (
        ({"centre_mm": "900, 0"}, "'900, 0' is not three numbers."),
        ({"orientation_deg": "<b>"}, "'<b>' is not three numbers."),
        ({"limit_mm": "-1"}, "'-1' is no length."),
    ):
        assert said in page(api, "plans/iso9283", target=target, **{**CUBE, **wrong})
    page(api, "plans/iso9283", 404, target="tgt_none")
    page(api, "plans/iso9283", 422, side_mm=-1)
    page(api, "plans/iso9283.exe", 404, target=target)
    robot = make_robot(api)
    assert "Home is not 6 angles." in page(api, f"robots/{robot}/plan", target=target, home="1, 2")


def test_a_key_that_only_reads_plans_nothing(api: Any) -> None:
    """The API computes plans for keys of scope upload; so do the pages."""
    from app.http import COOKIE, begin_sign_in
    from app.services.keys import create_key

    key = create_key(api.installation, "reader", "read").key
    cookie = {"Authorization": "", "Cookie": f"{COOKIE}={begin_sign_in(api.installation, key)}"}
    robot, session = make_robot(api), api.make_session()
    for address in (
        *("plans/iso9283", "plans/iso9283.csv", f"robots/{robot}/plan", f"sessions/{session}/next-view"),
    ):
        assert api.client.get(f"/ui/{address}", headers=cookie).status_code == 403, address
    assert "/plan" not in api.client.get(f"/ui/robots/{robot}", headers=cookie).text


@pytest.mark.slow
def test_a_cube_is_planned_and_its_files_are_taken_along(api: Any, target: str) -> None:
    shown = page(api, "plans/iso9283", target=target, **CUBE)
    rows = re.findall(r'<th scope="row">([PT]\d)</th><td class="num">([^<]+)</td>', shown)
    assert [name for name, _ in rows] == ["P1", "P2", "P3", "P4", "P5", "T1", "T2", "T3", "T4"]
    assert rows[0][1] == "900.0, 0.0, 450.0"
    assert "10 cycles, 54 images" in shown
    assert "pass 100 %" in shown
    assert "the verdict is “robot” from an RP" in page(
        api, "plans/iso9283", target=target, **CUBE, rp_mm=0.001
    )
    links = dict(re.findall(r'href="(/ui/plans/iso9283\.(?:\w+)\?[^"]+)">(\w+)', shown))
    assert [links[one] for one in sorted(links)] == ["Poses", "Plan", "Check"]
    files = {one.split("?")[0][-3:]: api.client.get(one, headers=signed_in(api)) for one in links}
    assert files["pdf"].content.startswith(b"%PDF-")
    assert files["csv"].text.splitlines()[1] == "P1,900.0,0.0,450.0,180.0,0.0,0.0,"
    assert files["son"].json()["cube"]["centre_mm"] == [900.0, 0.0, 450.0]
    far = page(api, "plans/iso9283", target=target, **{**CUBE, "side_mm": 900, "rp_mm": 0.001})
    assert "The target is not wholly in the image at P" in far
    assert "pass 0 %, fail 0 %, inconclusive 100 %. No test passes without P" in far
    assert "A larger target in the image" not in far, "where a smaller one is advised"


@pytest.mark.slow
def test_an_identification_is_planned_with_what_further_poses_gain(api: Any, target: str) -> None:
    robot = make_robot(api)
    asked = {"target": target, "home": HOME, "sweep_deg": 10, "steps": 5, "free": 10, "suggest": 3}
    shown = page(api, f"robots/{robot}/plan", **asked)
    assert re.search(r"\d+ of 40 poses show the whole grid", shown)
    assert "cannot be separated from" in shown
    assert not re.search(r"theta|alpha", shown), "as the table and the robot's page name parameters"
    gains = [float(one) for one in re.findall(r">([\d.]+) times smaller<", shown)]
    assert len(gains) > 10
    assert min(gains) >= 0.99, "more poses never determine less"
    assert max(gains) > 1.05
    suggested = shown[shown.index('id="suggested"') :]
    assert len(re.findall(r'<th scope="row">\d</th>', suggested)) == 3


def test_next_views_are_chosen_by_focus_group_where_there_are_several(api: Any, grey_png: bytes) -> None:
    session = api.make_session()
    for k, group in enumerate(("near", "far & wide", "near")):
        sent = api.put_image(session, grey_png + bytes([k]), f"P{k}", focus_group=group)
        assert sent.status_code == 202, sent.text

    def links(**query: Any) -> list[tuple[str, str]]:
        nav = page(api, f"sessions/{session}/next-view", **query).partition('aria-label="Focus group"')[2]
        return re.findall(
            r"focus_group=([^\"&]+)\"[^>]*?( aria-current)?(?:=\"page\")?>", nav.partition("</nav>")[0]
        )

    assert links() == [("far+%26+wide", ""), ("near", "")]
    assert links(focus_group="near") == [("far+%26+wide", ""), ("near", " aria-current")]
    assert links(purpose="hand_eye") == []
    part = environment().get_template("planning/_next_view.html")
    known = {"session_id": session, "settings": {"purpose": "intrinsics"}, "focus_groups": ["near", "far"]}
    refused = AnalysisRefused("focus_group_required", "Several.", "Name one of them (`focus_group`).")
    assert "focus_group`" not in part.render(**known, refused=refused, path="")


@pytest.mark.slow
def test_the_camera_page_names_what_is_blank_and_which_views_help(api: Any) -> None:
    session = new_session(api)
    store_shots(api, session, shoot(3, poses=3, cycles=2))
    (group,) = body(api.client.get(f"/v1/sessions/{session}/intrinsics"))["groups"]
    found = group["projection_uncertainty"]
    assert found["blank_areas"], "three poses leave parts of the image blank"
    shown = page(api, f"sessions/{session}/camera")
    assert f"Blank: {', '.join(found['blank_areas'])}." in shown
    for area in found["areas"]:
        assert re.search(rf'<th scope="row">{area["name"]}</th>', shown), area["name"]
    assert f"/v1/sessions/{session}/intrinsics/projection-uncertainty.svg" in shown
    drawn = api.client.get(f"/v1/sessions/{session}/intrinsics/projection-uncertainty.svg").text
    assert "<pattern" in drawn, "blank cells are hatched"
    assert f"blank: {', '.join(found['blank_areas'])}" in html.unescape(drawn)
    views = page(api, f"sessions/{session}/next-view")
    after = re.findall(r'<td class="num">([\d.]+)</td><td class="num">[\d.]+</td></tr>', views)
    assert len(after) == 3
    assert np.all(np.diff([float(one) for one in after]) <= 0.0), "each view adds to those before it"


@pytest.mark.parametrize("purpose", ["hand_eye", pytest.param("dh", marks=pytest.mark.slow)])
def test_next_views_of_a_robot_are_shown_with_their_joint_angles(api: Any, purpose: str) -> None:
    session = store_robot_session(api).id
    asked = api.client.post(f"/v1/sessions/{session}/next-view", json={"purpose": purpose, "count": 3})
    first = body(asked)["suggestions"][0]
    shown = page(api, f"sessions/{session}/next-view", purpose=purpose)
    assert first["instruction"] in shown
    figures = re.findall(
        r'<span class="pair-figure">([^<]+)</span>', shown[: shown.index("</tr>", shown.index("°</span>"))]
    )
    assert figures == [
        *("joints", *(f"{fixed(angle, 1)}°" for angle in first["joint_angles_deg"])),
        *("flange at x, y, z", *(fixed(row[3], 0) for row in first["T_base_flange"][:3])),
    ]
    after = re.findall(r'<td class="num">([^<]+) mm<br>[^<]+°</td></tr>', shown)
    assert after[0] == number(first["expected_uncertainty_after"]["length_rms_mm"], 2)
    assert np.all(np.diff([float(one) for one in after]) <= 0.0), "each view adds to those before it"
    chosen = re.search(r'<a href="[^"]*purpose=(\w+)"[^>]*aria-current="page"', shown)
    assert chosen is not None
    assert chosen[1] == purpose


def test_next_views_of_a_robot_are_offered_where_its_images_are(api: Any) -> None:
    session = store_robot_session(api).id
    assert f'hx-get="/ui/sessions/{session}/next-view?purpose=dh"' in page(api, f"sessions/{session}/robot")
    page(api, f"sessions/{session}/next-view", 422, purpose="tool")


@pytest.mark.slow
def test_the_robot_page_shows_repeatability_elsewhere(api: Any) -> None:
    robot = make_robot(api)
    limited = [{**row, "minimum_deg": -90.0, "maximum_deg": 90.0} for row in joint_rows(KR5_ARC)]
    assert api.client.patch(f"/v1/robots/{robot}", json={"joints": limited}).status_code == 200
    session = new_session(api, robot_id=robot)
    _, data, _ = repeated_poses(21, poses=8, visits=8)
    send(api, session, [{**row, "cycle": i % 8 + 1} for i, row in enumerate(readings(data))])
    query = {"source": "measured_poses"}
    answer = body(api.client.get(f"/v1/sessions/{session}/joint-noise", params=query))
    shown = page(api, f"sessions/{session}/joint-noise", **query)
    x, y, z = (round(value) for value in answer["worst_place"]["position_mm"])
    assert f"at x, y, z {x}, {y}, {z} mm".replace("-", "−") in shown
    assert "joint-noise/map.svg?source=measured_poses" in shown
    assert len(re.findall(r'<th scope="row">\d</th>', shown)) == 6
    lead = page(api, f"sessions/{session}/robot", **query)
    assert f'hx-get="/ui/sessions/{session}/joint-noise?source=measured_poses"' in lead
    assert f"/ui/robots/{robot}/plan" in lead
