"""What the API refuses a form of a page: a fragment in the pages' words; programs get the problem document."""

from __future__ import annotations

import re
from html import unescape
from typing import Any

import pytest

from app.errors import StorageFull
from app.services import sessions
from tests.app.web.test_page_words import TECHNICAL

SCRIPT = {"HX-Request": "true"}
JOINT = {"a_mm": 180.0, "alpha_deg": -90.0, "d_mm": 400.0}
CHARUCO = {"name": "T", "kind": "charuco", "columns": 9, "rows": 6, "pitch_mm": 25.0}
METRES = [{**JOINT, "a_mm": 0.18, "d_mm": 0.4}] * 6
CASES = (
    ("/v1/sessions", {"name": "", "target_ids": [], "conditions": {"temperature_c": 999}}),
    ("/v1/sessions", {"name": "S", "target_ids": ["tgt_" + "0" * 26]}),
    ("/v1/sessions", {"name": "S\u202e"}),
    ("/v1/robots", {"name": "R", "joints": METRES, "datasheet_repeatability_mm": 0.1}),
    ("/v1/robots", {"name": "R", "joints": [{**JOINT, "d_mm": "x"}], "datasheet_accuracy_mm": -1}),
    ("/v1/targets", {**CHARUCO, "marker_mm": 30.0, "dictionary": "DICT_5X5_250"}),
    ("/v1/targets", {**CHARUCO, "marker_mm": 15.0}),
    ("/v1/keys", {"name": "K", "scope": "read", "expires_in_days": "soon"}),
)


def text_of(fragment: str) -> str:
    return unescape(re.sub(r"<[^>]+>|\s+", " ", fragment))


@pytest.mark.parametrize(("address", "body"), CASES)
def test_a_form_is_refused_in_the_words_of_the_pages(api: Any, address: str, body: Any) -> None:
    problem = api.client.post(address, json=body)
    assert problem.headers["content-type"] == "application/problem+json"
    refused = api.client.post(address, json=body, headers=SCRIPT)
    assert refused.status_code == problem.status_code == 422
    assert refused.headers["content-type"] == "text/html; charset=utf-8"
    assert "HX-Request" in refused.headers["vary"]
    assert not TECHNICAL.search(text_of(refused.text)), text_of(refused.text)
    fields = [one["field"] for one in problem.json()["errors"]]
    assert re.findall('data-field="(.*?)"', refused.text) == fields
    assert f'data-code="{problem.json()["code"]}"' in refused.text


def test_a_sheet_whose_pitches_are_wrong_is_refused_once_and_in_words(api: Any) -> None:
    address = f"/v1/targets/{api.make_target()}"
    body = {"certificate": {"pitch_x_mm": 25.0, "pitch_y_mm": 25.0}}
    shown = text_of(api.client.patch(address, json=body, headers=SCRIPT).text)
    assert shown.count("The certificate states pitches without standard uncertainty.") == 1
    assert "State both pitches and the standard uncertainty of each." in shown
    assert not TECHNICAL.search(shown), shown


def test_an_image_that_is_at_the_pose_already_is_linked(api: Any, grey_png: bytes) -> None:
    session_id = api.make_session()
    first, second = (api.put_image(session_id, grey_png, pose).json()["id"] for pose in ("P1", "P2"))
    answer = api.client.patch(f"/v1/measurements/{second}", json={"pose_id": "P1"}, headers=SCRIPT)
    assert answer.status_code == 409
    assert f'already, as <a href="/ui/measurements/{first}"><bdi>image 1</bdi></a>.' in answer.text
    assert "have an administrator delete it" in answer.text
    assert not TECHNICAL.search(text_of(answer.text))


@pytest.mark.parametrize(
    ("scope", "shown"),
    [
        ("read", "The API key's scope is read; this needs upload. Sign in with a key of scope upload."),
        (None, "You are signed out. Sign in again."),
    ],
)
def test_a_key_that_may_not_is_said_in_words(api: Any, scope: str | None, shown: str) -> None:
    key = {"Authorization": ""} if scope is None else api.key(scope)
    answer = api.client.post("/v1/sessions", json={"name": "S"}, headers={**SCRIPT, **key})
    assert answer.status_code == (401 if scope is None else 403)
    assert shown in " ".join(text_of(answer.text).split())


def test_a_full_disk_is_said_in_words(api: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise StorageFull

    target_id = api.make_target()
    monkeypatch.setattr(sessions, "new_id", full)
    body = {"name": "S", "target_ids": [target_id]}
    answer = api.client.post("/v1/sessions", json=body, headers=SCRIPT)
    assert answer.status_code == 507
    assert answer.headers["retry-after"] == "5"
    assert "nothing was stored: do this again afterwards." in answer.text
