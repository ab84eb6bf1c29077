"""The robot's page of a session: what is claimed of an identification, and what its files are said to hold."""

from __future__ import annotations

import html
import math
import re
from typing import Any

import pytest

from app.web.robot_parameters import MIN_ARC_DEG, WEAKENING, joint_rows, objections, weak_joints
from app.web.routes.planning.session_advice import views_of
from core.kinematics.results import SHORT_ARC
from tests.support.service.signed_in import signed_in
from tests.support.sessions.robot_session import store_robot_session
from tests.support.sessions.stored_sessions import new_session

NAMES = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg", "beta_deg")


def identified(validation: Any, *codes: str, arcs: tuple[float, ...] = (120.0,)) -> dict[str, Any]:
    """An identification of joints of which each a is five uncertainties off the data sheet."""
    joints = [
        {
            **{"joint": i + 1, **dict.fromkeys(NAMES, 0.0), "a_mm": 180.5, "beta_deg": None, "arc_deg": arc},
            "nominal": {**dict.fromkeys(NAMES[:4], 0.0), "a_mm": 180.0},
            "identifiable": {**dict.fromkeys(NAMES, False), "a_mm": True},
            "standard_uncertainty": {**dict.fromkeys(NAMES), "a_mm": 0.1},
        }
        for i, arc in enumerate(arcs)
    ]
    return {"joints": joints, "validation": validation, "warnings": [{"code": one} for one in codes]}


HELD_OUT = {"position_rms_mm": 0.1}


@pytest.mark.parametrize(
    ("validation", "codes", "shown"),
    [
        (HELD_OUT, (), True),
        # What the uncertainties state already, and what concerns others than the parameters, takes nothing from them.
        (HELD_OUT, ("scale_taken_as_exact", "joints_move_together", "ill_conditioned"), True),
        (HELD_OUT, ("methods_disagree", "poses_excluded", "approach_matters"), True),
        (None, (), False),
        *((HELD_OUT, (code,), False) for code in sorted(WEAKENING)),
    ],
)
def test_a_difference_is_claimed_of_a_sound_identification_alone(
    validation: Any, codes: tuple[str, ...], shown: bool
) -> None:
    document = identified(validation, *codes)
    rows = joint_rows(document)
    assert [row["stands_out"] for row in rows] == [shown, False, False, False]
    assert rows[0]["ratio"] == "5.0", "the figures themselves are shown either way"
    assert (not objections(document)) is shown


def test_a_short_arc_concerns_the_parameters_next_to_its_axis() -> None:
    assert math.radians(MIN_ARC_DEG) == SHORT_ARC
    document = identified(HELD_OUT, "short_arc", arcs=(120.0, 90.0, 12.0, 90.0))
    assert weak_joints(document) == [2, 3]
    assert [row["joint"] for row in joint_rows(document) if row["stands_out"]] == [1, 4]
    assert objections(document) == []
    assert objections(identified(HELD_OUT, "short_arc", arcs=(12.0, 15.0, 12.0)))


def test_what_is_held_says_at_what() -> None:
    document = identified(HELD_OUT)
    assert [row["identified"] for row in joint_rows(document)][1:] == ["as the data sheet"] * 3
    document["joints"][0]["nominal"] = None
    rows = joint_rows(document)
    assert [row["identified"] for row in rows][1:] == ["0 (held)"] * 3
    assert rows[0]["difference"] == rows[0]["nominal"]
    document["joints"][0] |= {"nominal": dict.fromkeys(NAMES[:4], 5.0)}
    assert [row["identified"] for row in joint_rows(document)][1:] == ["0 (held)"] * 3


def test_a_weak_identification_says_so_before_its_table_and_at_its_files(api: Any) -> None:
    session = store_robot_session(api).id
    answer = api.client.get(f"/v1/sessions/{session}/dh").json()
    assert objections(answer)
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
