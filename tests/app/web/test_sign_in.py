"""The dashboard's door: sign-in by key, cookie flags, CSRF tokens, keys that end, and pages that need a key."""

from __future__ import annotations

import re
from datetime import timedelta
from http.cookies import SimpleCookie
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from app import web
from app.http import COOKIE, LASTS_S
from app.services.keys import create_key, revoke_key
from tests.support.service.service import ApiMaker, assert_problem

PAGES = (
    *("/ui/", "/ui/sessions/new", "/ui/robots", "/ui/targets", "/ui/targets/new", "/ui/keys", "/ui/audit"),
    *("/ui/system", "/ui/nothing", "/ui/sessions/none", "/ui/measurements/none"),
)


def browser(api: Any) -> TestClient:
    """A browser that is not signed in; it follows no redirect by itself."""
    client = TestClient(api.client.app, base_url="http://localhost", follow_redirects=False)
    client.portal = api.client.portal  # the event loop on which the application runs
    return client


def token_of(page: str) -> str:
    found = re.search(r'name="csrf_token" value="([0-9a-f]{64})"', page)
    assert found is not None
    return found[1]


def sign_in(client: TestClient, key: str, **fields: str) -> Any:
    form = client.get("/ui/sign-in").text
    return client.post("/ui/sign-in", data={"csrf_token": token_of(form), "key": key, **fields})


def new_key(api: Any, scope: str = "upload", **limits: Any) -> Any:
    return create_key(api.installation, f"key of scope {scope}", scope, **limits)


def page_token(client: TestClient) -> str:
    found = re.search(r'name="csrf-token" content="([0-9a-f]{64})"', client.get("/ui/").text)
    assert found is not None
    return found[1]


def test_pages_lead_who_has_no_key_to_the_sign_in_and_back(api: Any) -> None:
    client = browser(api)
    for page in PAGES:
        response = client.get(page)
        assert (response.status_code, response.headers["location"]) == (
            303,
            f"/ui/sign-in?next={page.replace('/', '%2F')}",
        )
    response = sign_in(client, new_key(api).secret_key, next="/ui/targets")
    assert (response.status_code, response.headers["location"]) == (303, "/ui/targets")
    assert client.get("/ui/targets").status_code == 200


def test_the_cookie_is_out_of_reach_of_scripts_and_other_sites_and_holds_no_secret(api: Any) -> None:
    key = new_key(api).secret_key
    response = sign_in(browser(api), key)
    morsel = SimpleCookie(response.headers.get_list("set-cookie")[0])[COOKIE]
    assert (morsel["httponly"], morsel["samesite"], morsel["path"]) == (True, "strict", "/")
    assert int(morsel["max-age"]) == LASTS_S
    assert not morsel["secure"]  # it came by plain HTTP
    assert key.rpartition("_")[2] not in response.headers["set-cookie"]
    client = browser(api)
    form = client.get("/ui/sign-in", headers={"X-Forwarded-Proto": "https"})
    assert "Secure" in form.headers["set-cookie"]


@pytest.mark.parametrize(
    "address", ["https://evil.test/", "//evil.test", "/ui/\\evil.test", "/v1/keys", "/ui//evil.test"]
)
def test_nobody_is_led_to_another_site(api: Any, address: str) -> None:
    response = sign_in(browser(api), new_key(api).secret_key, next=address)
    assert response.headers["location"] == "/ui/"


def test_a_wrong_key_and_one_that_only_sends_are_refused_in_words(api: Any) -> None:
    client = browser(api)
    for key, status, words in (
        ("gp_no_key", 401, "not valid"),
        ("", 401, "not valid"),
        (new_key(api, "ingest").secret_key, 403, "scope ingest"),
    ):
        response = sign_in(client, key)
        assert (response.status_code, COOKIE in response.cookies) == (status, False)
        assert words in response.text


def test_a_form_of_another_browser_or_of_none_is_refused(api: Any) -> None:
    key, elsewhere = new_key(api).secret_key, token_of(browser(api).get("/ui/sign-in").text)
    client = browser(api)
    client.get("/ui/sign-in")
    for token in ("", elsewhere):
        assert client.post("/ui/sign-in", data={"csrf_token": token, "key": key}).status_code == 403
    assert client.post("/ui/sign-in", content=b"a=" + b"x" * 100_000).status_code == 403


def test_changes_need_the_csrf_token_and_reading_does_not(api: Any) -> None:
    client = browser(api)
    sign_in(client, new_key(api).secret_key)
    body = {"name": "board", "kind": "chessboard", "columns": 9, "rows": 6, "pitch_mm": 25.0}
    assert client.get("/v1/targets").status_code == 200
    token = page_token(client)
    for wrong in ({}, {"X-CSRF-Token": "0" * 64}, {"X-CSRF-Token": "é"}):
        headers = {name: value.encode() for name, value in wrong.items()}
        assert_problem(client.post("/v1/targets", json=body, headers=headers), 403, "csrf_token_invalid")
    assert client.post("/v1/targets", json=body, headers={"X-CSRF-Token": token}).status_code == 201
    other = browser(api)
    sign_in(other, new_key(api).secret_key)
    stolen = other.post("/v1/targets", json=body, headers={"X-CSRF-Token": token})
    assert_problem(stolen, 403, "csrf_token_invalid")


def test_a_revoked_or_expired_key_ends_every_sign_in_with_it(api: Any) -> None:
    for limits in ({}, {"expires_in": timedelta(days=1)}):
        key = new_key(api, **limits)
        client = browser(api)
        sign_in(client, key.secret_key)
        assert client.get("/ui/").status_code == 200
        revoke_key(api.installation, key.key.id)
        response = client.get("/ui/")
        assert (response.status_code, response.headers["location"]) == (
            303,
            "/ui/sign-in?next=%2Fui%2F&ended=1",
        )
        assert "signed out" in client.get(response.headers["location"]).text
        assert_problem(client.get("/v1/targets"), 401, "not_authenticated")
        fragment = client.get("/ui/", headers={"HX-Request": "true"})
        assert (fragment.status_code, fragment.headers["hx-redirect"]) == (401, "/ui/sign-in?ended=1")
    expired = new_key(api, expires_in=timedelta(seconds=-1))
    assert sign_in(browser(api), expired.secret_key).status_code == 401


def test_a_cookie_that_was_changed_or_is_too_old_opens_nothing(
    api: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = browser(api)
    sign_in(client, new_key(api).secret_key)
    good = client.cookies[COOKIE]
    key_id, made_at, nonce, mac = good.split(".")
    other = new_key(api, "admin").key.id
    for forged in (
        f"{other}.{made_at}.{nonce}.{mac}",
        f"{key_id}.{int(made_at) + 1}.{nonce}.{mac}",
        f"{key_id}.{made_at}.{nonce}.{mac[:-1]}",
        *("", "...", "é", "x" * 10_000, good.upper()),
    ):
        response = browser(api).get("/ui/", headers={"Cookie": f"{COOKIE}={forged}".encode()})
        assert response.status_code == 303
    assert client.get("/ui/").status_code == 200
    monkeypatch.setattr("app.http.sign_in.time.time", lambda: int(made_at) + LASTS_S + 1)
    assert client.get("/ui/").status_code == 303


def test_use_renews_the_cookie_and_keeps_its_forms_valid(api: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    client = browser(api)
    sign_in(client, new_key(api).secret_key)
    made_at, token = int(client.cookies[COOKIE].split(".")[1]), page_token(client)
    assert "set-cookie" not in client.get("/ui/").headers
    monkeypatch.setattr("app.http.sign_in.time.time", lambda: made_at + 7200)
    assert COOKIE in client.get("/ui/").headers["set-cookie"]
    assert page_token(client) == token


def test_signing_out_takes_the_cookie_and_needs_the_token(api: Any) -> None:
    client = browser(api)
    sign_in(client, new_key(api).secret_key)
    client.post("/ui/sign-out", data={"csrf_token": "0" * 64})
    assert client.get("/ui/").status_code == 200
    client.post("/ui/sign-out", data={"csrf_token": page_token(client)})
    assert client.get("/ui/").status_code == 303


def test_pages_obey_the_keys_scope_and_sessions(api: Any) -> None:
    mine, other = api.make_session(), api.make_session()
    reader = browser(api)
    sign_in(reader, new_key(api, "read").secret_key)
    for page in ("/ui/keys", "/ui/audit"):
        response = reader.get(page)
        assert (response.status_code, "scope" in response.text) == (403, True)
        assert page not in reader.get("/ui/").text  # no link leads where the key may not go
    limited = browser(api)
    sign_in(limited, new_key(api, "read", session_ids=[mine]).secret_key)
    listed = limited.get("/ui/").text
    assert (mine in listed, other in listed) == (True, False)
    assert limited.get(f"/ui/sessions/{mine}").status_code == 200
    assert limited.get(f"/ui/sessions/{other}").status_code == 404


def test_pages_have_a_strict_policy_and_nothing_inline(api: Any) -> None:
    client = browser(api)
    sign_in(client, new_key(api, "admin").secret_key)
    session_id = api.make_session(name="<script>alert(1)</script>")
    for page in (*PAGES, f"/ui/sessions/{session_id}", f"/ui/sessions/{session_id}/upload"):
        response = client.get(page)
        policy = response.headers["content-security-policy"]
        assert "default-src 'self'" in policy
        assert "unsafe" not in policy
        assert not re.search(r"<script(?! src=)|<style|\sstyle=|\son\w+=|javascript:", response.text), page
        assert "<script>alert" not in response.text
        assert not re.search(r'(?:src|href|action)="(?:https?:)?//', response.text)


def test_static_files_are_kept_by_browsers_and_need_no_key(api: Any) -> None:
    client = browser(api)
    page = client.get("/ui/sign-in").text
    addresses = re.findall(r'(?:src|href)="(/ui/static/[^"]+)"', page)
    assert len(addresses) >= 5
    for address in addresses:
        response = client.get(address)
        assert (response.status_code, "immutable" in response.headers["cache-control"]) == (200, True)
    old = re.sub(r"/static/\w+/", "/static/before/", addresses[0])
    assert client.get(old).headers["cache-control"] == "no-cache"
    assert client.get("/ui/static/x/../../pages.py").status_code in (303, 404)
    assert client.get("/ui/static/x/nothing.js").status_code == 404


def test_without_keys_pages_are_open_to_this_machine_alone(open_api: ApiMaker) -> None:
    with open_api(auth="off") as open_service:
        client = browser(open_service)
        assert client.get("/ui/keys").status_code == 200
        assert "keys are off" in client.get("/ui/").text
        assert client.get("/ui/", headers={"Host": "evil.test"}).status_code == 403
        assert client.get("/ui/sign-in").headers["location"] == "/ui/"


def test_no_form_carries_the_token_into_an_address() -> None:
    """A form without `method="post"` that a browser sends by itself has all its fields in the address, and in logs."""
    templates = (Path(web.__file__).parent / "templates").rglob("*.html")
    forms = [
        form for page in templates for form in re.findall(r"<form.*?</form>", page.read_text(), re.DOTALL)
    ]
    assert len(forms) > 10
    with_token = [form for form in forms if "csrf_token" in form]
    assert with_token
    assert all('method="post"' in form.partition(">")[0].split(" data-")[0] for form in with_token)
