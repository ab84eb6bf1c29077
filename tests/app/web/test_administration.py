"""Pages of the administrator: what happened by whose key, and whether the service is well."""

from __future__ import annotations

import re
from datetime import timedelta
from html import unescape
from typing import Any
from urllib.parse import unquote

import pytest

from app.records.tables import Measurement
from app.services.health import Check
from app.services.inspection import CheckResult, State
from app.services.keys import change_key, create_key
from app.web import health
from app.web.health import Health
from app.web.routes import administration
from tests.support.service.signed_in import signed_in


def page(api: Any, address: str, **query: Any) -> str:
    response = api.client.get(f"/ui/{address}", params=query, headers=signed_in(api))
    assert response.status_code == 200, response.text
    return unescape(response.text)


def test_many_keys_have_more_than_one_page(api: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(administration, "KEYS_PAGE", 2)
    for number in range(3):
        create_key(api.installation, f"Press {number}", "upload")
    shown, query = "", {}
    for _ in range(4):
        one = page(api, "keys", **query)
        shown += one
        following = re.search(r'rel="next" href="/ui/keys\?cursor=([^"]+)"', one)
        if following is None:
            break
        query = {"cursor": unquote(following[1])}
    assert following is None
    assert [shown.count(f"<bdi>Press {number}</bdi>") for number in range(3)] == [1, 1, 1]


def test_the_audit_trail_is_chosen_by_the_name_or_the_id_of_a_key(api: Any) -> None:
    press, other = (create_key(api.installation, name, "upload") for name in ("Press 4, 100 %", "Other"))
    for number, key in enumerate((press, other)):
        body = {"name": f"S{number}", "target_ids": [api.make_target(name=f"T{number}")]}
        bearer = {"Authorization": f"Bearer {key.secret_key}"}
        assert api.client.post("/v1/sessions", json=body, headers=bearer).status_code == 201

    def sessions(key: str) -> list[str]:
        shown = page(api, "audit", key=key)
        return sorted(re.findall(r'title="ses_\w+">session <bdi>(\w+)</bdi>', shown))

    assert sessions("") == ["S0", "S1"]
    for known in (press.key.id, press.key.name, " press 4", "100 %"):
        assert sessions(known) == ["S0"], known
    assert sessions("%") == ["S0"], "no wildcard"
    change_key(api.installation, press.key.id, {"name": "Press 5"})
    assert sessions("Press 5") == sessions("Press 4") == ["S0"], "by its present and its former name"
    link = f'<a href="/ui/audit?key={press.key.id}" title="{press.key.id}"><bdi>Press 4, 100 %</bdi></a>'
    assert link in page(api, "audit")


@pytest.mark.parametrize("ok", [True, False])
@pytest.mark.parametrize(
    "found", [(), (State.ok, State.warning), (State.warning, State.warning), (State.failed,)]
)
def test_health_is_the_worst_of_all_that_was_found(ok: bool, found: tuple[State, ...]) -> None:
    whole = Health([Check("disk", ok, "No room.")], {"Database": [CheckResult(one, "…") for one in found]})
    if not ok:
        assert (whole.kind, whole.sentence) == ("bad", "The service cannot do all its work. No room.")
    elif State.failed in found:
        assert whole.kind == "bad"
    elif State.warning in found:
        points = {1: "1 point needs a look", 2: "2 points need a look"}[found.count(State.warning)]
        assert (whole.kind, whole.sentence) == ("fair", f"Every part does its work; {points}.")
    else:
        assert (whole.kind, whole.sentence) == ("good", "All is well.")


def test_images_that_nothing_computes_are_said(
    api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    session_id = api.make_session()
    made = [api.put_image(session_id, grey_png + bytes([k]), f"P{k}").json()["id"] for k in range(2)]

    def said(address: str) -> list[str]:
        return re.findall(r'<p class="health fair">.*?(\d+) images', page(api, address))

    addresses = ("", "system", f"sessions/{session_id}")
    assert [said(one) for one in addresses] == [[], [], []], "they came just now"
    monkeypatch.setattr(health, "TAKEN_WITHIN", timedelta(0))
    assert [said(one) for one in addresses] == [["2"]] * 3
    assert re.search(r'runner</th><td><span class="badge fair">', page(api, "system"))
    with api.installation.database.write() as records:
        records.get_one(Measurement, made[0]).status = "running"
    assert [said(one) for one in addresses] == [[], [], []], "another process computes"


def test_the_first_page_and_the_system_page_say_the_same_of_the_service(api: Any) -> None:
    def said(address: str) -> str:
        found = re.search(
            r'<p class="health \w+">(.*?)(?: <a href="/ui/system">Details</a>)?</p>', page(api, address)
        )
        assert found is not None
        return found[0].partition(" <a")[0].removesuffix("</p>")

    before = said("")
    assert said("system") == before
    (api.installation.settings.data_dir / "first-admin-key").write_text("a key that should be elsewhere")
    after = said("")
    assert after != before
    assert "a look" in after
    assert said("system") == after


def test_sizes_on_the_system_page_have_one_kind_of_unit(api: Any) -> None:
    shown = page(api, "system")
    assert re.search(r"\d [MG]B free", shown)
    assert not re.search(r"\d [KMGT]iB", shown)
