"""The robot's page of a session: what is claimed of an identification, and what its files are said to hold."""

from __future__ import annotations

import html
import re
from typing import Any

import pytest

from app.web.routes.planning.session_advice import views_of
from app.web.routes.robots import WEAKENING, joint_rows
from tests.support.service.signed_in import signed_in
from tests.support.sessions.robot_session import store_robot_session
from tests.support.sessions.stored_sessions import new_session

NAMES = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg", "beta_deg")


def identified(validation: Any, *codes: str) -> dict[str, Any]:
    """An identification of one joint, of which a is five uncertainties off the data sheet."""
    joint = {
        **{"joint": 1, **dict.fromkeys(NAMES, 0.0), "a_mm": 180.5, "beta_deg": None},
        "nominal": {**dict.fromkeys(NAMES[:4], 0.0), "a_mm": 180.0},
        "identifiable": {**dict.fromkeys(NAMES, False), "a_mm": True},
        "standard_uncertainty": {**dict.fromkeys(NAMES), "a_mm": 0.1},
    }
    return {"joints": [joint], "validation": validation, "warnings": [{"code": one} for one in codes]}


@pytest.mark.parametrize(
    ("validation", "codes", "shown"),
    [
        ({"position_rms_mm": 0.1}, (), True),
        ({"position_rms_mm": 0.1}, ("scale_taken_as_exact",), True),
        (None, (), False),
        *(({"position_rms_mm": 0.1}, (code,), False) for code in sorted(WEAKENING)),
    ],
)
def test_a_difference_is_claimed_of_a_sound_identification_alone(
    validation: Any, codes: tuple[str, ...], shown: bool
) -> None:
    rows = joint_rows(identified(validation, *codes))
    assert [row["stands_out"] for row in rows] == [shown, False, False, False]
    assert rows[0]["ratio"] == "5.0", "the figures themselves are shown either way"


def test_a_weak_identification_says_so_before_its_table_and_at_its_files(api: Any) -> None:
    session = store_robot_session(api).id
    answer = api.client.get(f"/v1/sessions/{session}/dh").json()
    assert {one["code"] for one in answer["warnings"]} & WEAKENING
    response = api.client.get(f"/ui/sessions/{session}/robot?compute=1", headers=signed_in(api))
    page = html.unescape(response.text)
    places = [page.index(text) for text in ("Not to be relied on", 'aria-label="Warnings"', 'id="dh-title"')]
    assert places == sorted(places)
    assert "differs</span>" not in page
    files = page[page.index("The files of the robot hold") : page.index("robot.urdf")]
    identifiable = [sum(joint["identifiable"].values()) for joint in answer["joints"]]
    assert f"{sum(identifiable)} identified parameters and, of the " in files
    assert "do not load them into a controller" in files


def suggestion(place: float, now: float, then: float) -> dict[str, Any]:
    known = {"projection_rms_px": None, "length_rms_mm": now}
    return {
        "T_target_camera": [[place]],
        "expected_uncertainty_now": known,
        "expected_uncertainty_after": {**known, "length_rms_mm": then},
    }


def test_views_that_gain_little_are_not_suggested_and_the_same_one_is_named() -> None:
    views = views_of([suggestion(1.0, 2.0, 1.0), suggestion(1.0, 1.0, 0.8), suggestion(2.0, 0.8, 0.79)])
    assert [(one["T_target_camera"], one["repeats"]) for one in views] == [([[1.0]], None), ([[1.0]], 1)]
    assert views_of([suggestion(1.0, 2.0, 1.95)]) == views_of([]) == []


def test_the_page_of_next_views_says_that_more_would_gain_little(
    api: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = store_robot_session(api).id
    monkeypatch.setattr("app.web.routes.planning.session_advice.MIN_GAIN", 0.9999)
    response = api.client.get(f"/ui/sessions/{session}/next-view", headers=signed_in(api))
    assert "One more view would make nothing smaller by 5 % or more." in response.text
    assert not re.search(r'aria-label="Next views"', response.text)


def test_the_mount_of_the_camera_is_asked_for_and_shown(api: Any) -> None:
    session = new_session(api, camera_mount="fixed")
    shown = {
        address: api.client.get(address, headers=signed_in(api)).text
        for address in (f"/ui/sessions/{session}", f"/ui/sessions/{session}/change", "/ui/sessions/new")
    }
    page, change, new = shown.values()
    assert "<dt>Camera</dt><dd>fixed, the target on the robot</dd>" in page
    assert '<option value="fixed" selected>' in change
    assert '<select id="mount" name="camera_mount"><option value="robot">' in new
