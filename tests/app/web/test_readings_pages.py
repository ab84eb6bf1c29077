"""Pages of a session whose poses another instrument measured speak of readings, not of images that are missing."""

from __future__ import annotations

import re
from typing import Any

import pytest

from app.web.words import rounded_by_interval
from tests.support.service.signed_in import signed_in
from tests.support.sessions.stored_sessions import new_session
from tests.support.sessions.tracked_robot import drawn_poses, readings, send


@pytest.fixture
def session_id(api: Any) -> str:
    """Three poses of ten cycles each."""
    made: str = new_session(api)
    send(api, made, readings(drawn_poses(9, 3), cycles=10))
    return made


def page(api: Any, address: str) -> str:
    response = api.client.get(f"/ui/{address}", headers=signed_in(api))
    assert response.status_code == 200, response.text
    return " ".join(response.text.split())


def test_the_list_of_sessions_counts_readings_and_has_their_headline(api: Any, session_id: str) -> None:
    listed = page(api, "")
    assert "30 readings" in listed
    assert "no images yet" not in listed
    assert f'data-headline="/ui/sessions/{session_id}/headline"' in listed
    headline = page(api, f"sessions/{session_id}/headline")
    (shown,) = re.findall(r"<b>(0\.\d+)</b> mm", headline)
    answer = api.client.get(f"/v1/sessions/{session_id}/repeatability?source=measured_poses").json()
    worst = max(answer["poses"], key=lambda pose: pose["repeatability"]["rp_l_mm"])
    assert shown == rounded_by_interval(worst["repeatability"]["rp_l_mm"], worst["interval"]["rp_l_mm"])
    assert "no figure" not in headline
    assert headline.split("</a>")[0] in page(api, ""), "it is kept for the next ones who ask"


def test_the_first_page_of_the_session_shows_the_readings_by_pose(api: Any, session_id: str) -> None:
    shown = page(api, f"sessions/{session_id}")
    assert "30 readings of 3 poses by another instrument" in shown
    assert "3 of 3 poses have fewer than 30 readings, which ISO 9283 asks for; the fewest are 10." in shown
    assert "No image is here yet" not in shown
    assert ">Readings</a>" in shown
    pose = re.findall(r'pose=(\w+)"', shown)[1]
    of_pose = page(api, f"sessions/{session_id}?source=measured_poses&pose={pose}")
    assert re.findall(r'<th scope="row" class="num">(\d+)</th>', of_pose) == [str(k) for k in range(1, 11)]
    assert "No reading is of pose" in page(api, f"sessions/{session_id}?pose=none")


def test_poses_lead_to_their_readings_and_no_estimator_is_offered(api: Any, session_id: str) -> None:
    shown = page(api, f"sessions/{session_id}/repeatability")
    assert f'href="/ui/sessions/{session_id}?pose=P1&amp;source=measured_poses"' in shown
    assert 'name="estimator"' not in shown
    assert 'name="estimator"' in page(api, f"sessions/{session_id}/repeatability?source=images")
    camera = page(api, f"sessions/{session_id}/camera")
    assert "there is no camera to show" in camera
    assert "Add images</a></p>" not in camera


def test_a_session_of_both_shows_images_and_leads_to_the_readings(
    api: Any, session_id: str, grey_png: bytes
) -> None:
    api.put_image(session_id, grey_png, "P1", cycle=1)
    shown = page(api, f"sessions/{session_id}")
    assert 'class="tile' in shown
    assert f'href="/ui/sessions/{session_id}?source=measured_poses"' in shown
    assert "the session has images, too" in page(api, f"sessions/{session_id}?source=measured_poses")
    assert "30 readings" not in page(api, "")
