"""What a key of each scope may do on every route, and what a key limited to sessions sees."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

import pytest

from app.api.middleware.authentication import PUBLIC, PUBLIC_FOLDER
from app.api.routing import StrictRoute
from app.errors import InvalidContent
from app.http import GRANTS
from app.services.keys import create_key
from app.web import routers
from app.web.pages import PageRoute

SIGN_IN = ("/ui/sign-in", "/ui/sign-out", "/ui/signed-in", "/ui/static/{version}/{name:path}")
SCOPES = ("read", "ingest", "upload", "admin")
SENDS_POSES_OR_IMAGES = re.compile(r"/v1/sessions/\{session_id\}/(images(/missing)?|poses(/\{pose_id\}.*)?)")
SHARED = {
    ("PATCH", "/v1/robots/{robot_id}"),
    ("PATCH", "/v1/targets/{target_id}"),
    ("POST", "/v1/robots/{robot_id}/events"),
}
JOINT = {"a_mm": 100.0, "alpha_deg": 0.0, "d_mm": 0.0}


def scopes_of(method: str, path: str) -> set[str]:
    """Which scopes the contract opens an address to, said independently of the program."""
    if path.startswith(("/v1/keys", "/v1/audit", "/v1/webhooks")) or method == "DELETE":
        return {"admin"}
    if path == "/v1/sessions/{session_id}/events":
        return set(SCOPES)
    if method == "GET":
        return {"read", "upload", "admin"}
    if method in ("PUT", "POST") and SENDS_POSES_OR_IMAGES.fullmatch(path):
        return {"ingest", "upload", "admin"}
    return {"upload", "admin"}


def addresses(api: Any) -> Iterator[tuple[str, str]]:
    """Every method and path that needs a key."""
    for path, item in api.client.app.openapi()["paths"].items():
        if path not in PUBLIC:
            yield from ((method.upper(), path) for method in item)


def filled(path: str, **ids: str) -> str:
    defaults = {"pose_id": "P1", "sha256": "0" * 64}
    return re.sub(r"\{(\w+)\}", lambda match: {**defaults, **ids}.get(match[1], "none"), path)


def test_every_route_is_open_to_its_scopes_alone(api: Any) -> None:
    keys = {scope: api.key(scope) for scope in SCOPES}
    checks = 0
    for method, path in addresses(api):
        for scope, headers in keys.items():
            response = api.client.request(method, filled(path), headers=headers)
            checks += 1
            if scope in scopes_of(method, path):
                assert response.status_code not in (401, 403), (method, path, scope, response.text)
            else:
                refusal = (response.status_code, response.json()["code"])
                assert refusal == (403, "insufficient_scope"), (method, path, scope)
    assert checks >= 4 * 41


def test_no_route_passes_the_check_by(api: Any) -> None:
    """Whoever adds a route of another class finds it here."""
    included = [getattr(route, "original_router", None) for route in api.client.app.routes]
    routes = [route for router in included if router is not None for route in router.routes]
    routes += [route for route, router in zip(api.client.app.routes, included, strict=True) if router is None]
    paths = [route.path for route in routes]
    assert len(paths) >= 43
    for route, path in zip(routes, paths, strict=True):
        is_open = path in (*PUBLIC, *SIGN_IN) or path.startswith(PUBLIC_FOLDER)
        assert isinstance(route, StrictRoute | PageRoute) or is_open, path


def test_every_page_asks_for_an_operation_of_the_contract(api: Any) -> None:
    """What a key may see as a page is what it may read by the API."""
    known = {
        each["operationId"] for item in api.client.app.openapi()["paths"].values() for each in item.values()
    }
    pages = [route for router in routers for route in router.routes if isinstance(route, PageRoute)]
    assert len(pages) >= 20
    for page in pages:
        assert page.methods == {"GET"}, page.path  # what changes something goes through the API
        assert page.operation_id in known, page.path


def test_scopes_hold_what_the_contract_says() -> None:
    assert GRANTS["upload"] == {"read", "ingest", "upload"}
    assert GRANTS["ingest"] == {"ingest"}
    assert GRANTS["admin"] == set(SCOPES)


def test_an_ingest_key_sends_images_and_reads_nothing(api: Any, grey_png: bytes) -> None:
    session_id = api.make_session()
    api.client.headers.update(api.key("ingest"))
    stored = api.put_image(session_id, grey_png)
    assert stored.status_code == 202
    images = {"images": [{"pose_id": "P1", "sha256": stored.json()["sha256"]}]}
    assert api.client.post(f"/v1/sessions/{session_id}/images/missing", json=images).json() == {"missing": []}
    for address in (
        stored.headers["location"],
        f"/v1/sessions/{session_id}",
        f"/v1/sessions/{session_id}/poses/P1",
        f"/v1/sessions/{session_id}/repeatability",
    ):
        assert api.client.get(address).status_code == 403


def test_an_ingest_key_completes_commanded_poses_and_changes_none(api: Any, grey_png: bytes) -> None:
    session_id = api.make_session()
    api.put_image(session_id, grey_png, "P1")  # makes the pose with nulls
    address = f"/v1/sessions/{session_id}/poses"
    first = {"position_mm": [100.0, 200.0, 300.0], "roll_deg": 10.0}
    ingest, upload = {"headers": api.key("ingest")}, {"headers": api.key("upload")}
    assert api.client.put(f"{address}/P1", json=first, **ingest).status_code == 200
    assert api.client.put(f"{address}/P1", json=first, **ingest).status_code == 200
    assert api.client.put(f"{address}/P1", json={**first, "yaw_deg": 5.0}, **ingest).status_code == 200
    assert api.client.put(f"{address}/P2", json=first, **ingest).status_code == 201
    stored = api.client.get(f"{address}/P1").json()

    for other, field in (
        ({**first, "yaw_deg": 5.1}, "yaw_deg"),
        ({"yaw_deg": 5.0, "roll_deg": 10.0}, "position_mm"),
        ({}, "position_mm"),
    ):
        refused = api.client.put(f"{address}/P1", json=other, **ingest)
        assert (refused.status_code, refused.json()["code"]) == (409, "commanded_pose_conflict")
        assert field in [error["field"] for error in refused.json()["errors"]]
        bulk = [{"pose_id": "P3", **first}, {"pose_id": "P1", **other}]
        refused = api.client.post(address, json=bulk, **ingest)
        assert (refused.status_code, refused.json()["code"]) == (409, "commanded_pose_conflict")
        assert f"1.{field}" in [error["field"] for error in refused.json()["errors"]]
    assert api.client.get(f"{address}/P1").json() == stored
    assert api.client.get(f"{address}/P3").status_code == 404, "all or nothing"

    same = [{"pose_id": "P3", **first}, {"pose_id": "P1", **first, "yaw_deg": 5.0}]
    assert api.client.post(address, json=same, **ingest).status_code == 200
    assert api.client.put(f"{address}/P1", json={}, **upload).status_code == 200, "upload corrects"


@pytest.fixture
def two_sessions(api: Any, grey_png: bytes) -> tuple[dict[str, str], dict[str, str]]:
    """The ids of two sessions with a target, a robot and an image each."""
    made = []
    for name in ("own", "other"):
        target_id = api.make_target(name=name)
        robot = api.client.post("/v1/robots", json={"name": name, "joints": [JOINT]}).json()
        session_id = api.make_session(target_id, name=name, robot_id=robot["id"])
        measurement = api.put_image(session_id, grey_png).json()
        ids = {"target_id": target_id, "robot_id": robot["id"], "session_id": session_id}
        made.append({**ids, "measurement_id": measurement["id"]})
    return made[0], made[1]


@pytest.mark.slow
def test_a_limited_key_finds_nothing_of_other_sessions_on_any_route(
    api: Any, two_sessions: tuple[dict[str, str], dict[str, str]]
) -> None:
    own, other = two_sessions
    headers = api.key("upload", session_ids=[own["session_id"]])
    absent = {name: f"{value[:4]}{'0' * 26}" for name, value in other.items()}
    checks = 0
    for method, path in addresses(api):
        if not set(re.findall(r"\{(\w+)\}", path)) & set(own) or scopes_of(method, path) == {"admin"}:
            continue
        unseen, missing = (
            api.client.request(method, filled(path, **ids), headers=headers) for ids in (other, absent)
        )
        if (method, path) in SHARED:  # other sessions name them, too: not even those that the key may see
            assert unseen.status_code == missing.status_code == 403, (method, path, unseen.text)
            continue
        assert unseen.status_code == 404, (method, path, unseen.text)
        assert unseen.json() == missing.json(), "what is not seen looks like what does not exist"
        checks += 1
        if path != "/v1/sessions/{session_id}/events":  # which does not end
            seen = api.client.request(method, filled(path, **own), headers=headers)
            assert seen.status_code not in (401, 403), (method, path)
            assert seen.status_code != 404 or "pose" in seen.json()["code"], (method, path)
    assert checks >= 20


def test_lists_hold_what_a_limited_key_may_see(
    api: Any, two_sessions: tuple[dict[str, str], dict[str, str]]
) -> None:
    own, _ = two_sessions
    headers = api.key("read", session_ids=[own["session_id"]])
    for noun in ("session", "target", "robot"):
        listed = api.client.get(f"/v1/{noun}s", headers=headers).json()
        assert [item["id"] for item in listed["items"]] == [own[f"{noun}_id"]]
        assert len(api.client.get(f"/v1/{noun}s").json()["items"]) == 2


def test_a_limited_key_cannot_reach_beyond_its_sessions_by_what_it_sends(
    api: Any, two_sessions: tuple[dict[str, str], dict[str, str]]
) -> None:
    own, other = two_sessions
    headers = api.key("upload", session_ids=[own["session_id"]])
    session = f"/v1/sessions/{own['session_id']}"
    for changes, code in (
        ({"target_ids": [own["target_id"], other["target_id"]]}, "referenced_target_not_found"),
        ({"robot_id": other["robot_id"]}, "referenced_robot_not_found"),
    ):
        refused = api.client.patch(session, json=changes, headers=headers)
        assert (refused.status_code, refused.json()["code"]) == (422, code)
    assert api.client.patch(session, json={"name": "mine"}, headers=headers).status_code == 200
    for method, address in (
        ("POST", "/v1/sessions"),
        ("POST", "/v1/targets"),
        ("POST", "/v1/robots"),
        ("GET", "/metrics"),
    ):
        refused = api.client.request(method, address, headers=headers, json={})
        assert (refused.status_code, refused.json()["code"]) == (403, "key_limited_to_sessions")


def test_an_original_that_another_session_holds_stays_when_a_limited_key_fails(
    api: Any, two_sessions: tuple[dict[str, str], dict[str, str]], grey_png: bytes
) -> None:
    """What a key may not see still counts for files: rows of all sessions hold an original."""
    own, other = two_sessions
    original = api.installation.blobs.path(
        api.client.get(f"/v1/measurements/{other['measurement_id']}").json()["sha256"]
    )
    third = api.make_session(own["target_id"])
    headers = api.key("upload", session_ids=[third], bytes_per_day=len(grey_png) - 1)
    api.client.delete(f"/v1/sessions/{own['session_id']}")
    api.client.headers.update(headers)
    files = {"image": ("x.png", grey_png, "image/png")}
    refused = api.client.post(f"/v1/sessions/{third}/images", files=files, data={"pose_id": "P1"})
    assert refused.status_code == 429
    assert original.read_bytes() == grey_png


def test_limits_are_given_when_a_key_is_made(api: Any) -> None:
    session_id = api.make_session()
    body = {"name": "cell", "scope": "ingest", "session_ids": [session_id], "bytes_per_day": 1000}
    made = api.client.post("/v1/keys", json=body)
    assert made.status_code == 201
    document = api.client.get(made.headers["location"]).json()
    assert (document["session_ids"], document["bytes_per_day"]) == ([session_id], 1000)
    assert document["bytes_today"] == 0
    for wrong, code in (
        ({"session_ids": ["ses_none"]}, "referenced_session_not_found"),
        ({"session_ids": [f"ses_{'0' * 26}"]}, "referenced_session_not_found"),
        ({"session_ids": []}, "invalid_request"),
        ({"session_ids": [session_id], "scope": "admin"}, "invalid_scope"),
        ({"bytes_per_day": 0}, "invalid_request"),
        ({"bytes_per_day": "all"}, "invalid_request"),
    ):
        refused = api.client.post("/v1/keys", json={**body, **wrong})
        assert (refused.status_code, refused.json()["code"]) == (422, code), json.dumps(wrong)
    with pytest.raises(InvalidContent):
        create_key(api.installation, "cell", "read", session_ids=[])


def test_name_and_quota_of_a_key_can_be_changed(api: Any) -> None:
    address = api.client.post("/v1/keys", json={"name": "cell", "scope": "read"}).headers["location"]
    assert api.client.patch(address, json={"bytes_per_day": 5}).json()["bytes_per_day"] == 5
    changed = api.client.patch(address, json={"name": "cell 7"}).json()
    assert (changed["name"], changed["bytes_per_day"]) == ("cell 7", 5)
    assert api.client.patch(address, json={"bytes_per_day": None}).json()["bytes_per_day"] is None
    assert api.client.patch(address, json={"scope": "admin"}).status_code == 422
    api.client.delete(address)
    assert api.client.patch(address, json={"name": "x"}).status_code == 409
