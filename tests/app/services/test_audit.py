"""Who changed what: entries, rows that know their makers, log lines, and when keys were last used."""

from __future__ import annotations

import ipaddress
import json
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
import sqlalchemy as sa

from app.api.middleware.client_address import client_address
from app.errors import InvalidContent
from app.logs import configure_logging
from app.records.activity import Activity, acting
from app.records.tables import ApiKey, AuditEntry, MeasuredPose, Measurement, Robot, Session, Target
from app.services.keys import create_key

JOINT = {"a_mm": 100.0, "alpha_deg": 0.0, "d_mm": 0.0}
READING = {"pose_id": "P1", "cycle": 1, "position_mm": [1.0, 2.0, 3.0]}


def entries(api: Any, **query: Any) -> list[dict[str, Any]]:
    response = api.client.get("/v1/audit", params={"limit": 500, **query})
    assert response.status_code == 200, response.text
    return list(response.json()["items"])


def test_every_change_has_one_entry_with_key_client_and_objects(any_api: Any, grey_png: bytes) -> None:
    api = any_api
    made = api.client.post("/v1/keys", json={"name": "cell 7", "scope": "admin"}).json()
    api.client.headers["Authorization"] = f"Bearer {made['key']}"
    target_id = api.make_target()
    robot_id = api.client.post("/v1/robots", json={"name": "r", "joints": [JOINT]}).json()["id"]
    session_id = api.make_session(target_id)
    session = f"/v1/sessions/{session_id}"
    measurement_id = api.put_image(session_id, grey_png).json()["id"]
    api.put_image(session_id, grey_png)  # the same again changes nothing
    requests = (
        ("PUT", f"{session}/poses/P2", {"roll_deg": 1.0}),
        ("POST", f"{session}/poses", [{"pose_id": "P3"}]),
        ("POST", f"{session}/measured-poses", [READING]),
        ("PATCH", session, {"name": "renamed"}),
        ("POST", f"/v1/measurements/{measurement_id}/retry", None),
        ("DELETE", session, None),
    )
    for method, address, body in requests:
        response = api.client.request(
            method, address, json=body, headers={"X-Request-ID": f"{method}.{address.count('/')}"}
        )
        assert response.is_success, response.text

    found = entries(api, key_id=made["id"])
    assert [(entry["action"], entry["object_ids"]) for entry in found] == [
        ("create_target", [target_id]),
        ("create_robot", [robot_id]),
        ("create_session", [session_id]),
        ("put_image", [session_id, "P1", measurement_id]),
        ("put_pose", [session_id, "P2"]),
        ("put_poses", [session_id]),
        ("put_measured_poses", [session_id]),
        ("update_session", [session_id]),
        ("retry_measurement", [measurement_id]),
        ("delete_session", [session_id]),
    ]
    assert {(e["actor"], e["key_name"], e["client"]) for e in found} == {("key", "cell 7", "testclient")}
    assert found[-1]["request_id"] == "DELETE.3"


def test_nothing_that_failed_or_read_has_an_entry(api: Any, grey_png: bytes) -> None:
    session_id = api.make_session()
    before = entries(api)
    api.client.post("/v1/targets", json={"name": "x"})
    api.client.patch(f"/v1/sessions/{session_id}", json={"target_ids": [f"tgt_{'0' * 26}"]})
    api.client.delete("/v1/sessions/none")
    api.client.post("/v1/targets", json={}, headers=api.key("read"))
    api.client.post(f"/v1/sessions/{session_id}/images/missing", json={"images": []})
    api.client.get("/readyz")
    assert entries(api) == before


def test_an_entry_lives_and_dies_with_its_change(api: Any) -> None:
    """Both are in one transaction: neither stands without the other."""
    database = api.installation.database
    robot = Robot(id=f"rob_{'0' * 26}", name="r", joints=[], created_at=datetime.now(UTC))

    def fail() -> None:
        with acting(Activity(actor="service", action="create_robot")), database.write() as records:
            records.add(robot)
            records.flush()
            raise InvalidContent("no")

    with pytest.raises(InvalidContent):
        fail()
    with database.read() as records:
        assert records.scalars(sa.select(Robot)).all() == []
        assert records.scalars(sa.select(AuditEntry)).all() == []


def test_entries_are_found_by_key_object_and_time_page_by_page(api: Any) -> None:
    first, second = api.make_target(), api.make_target()
    key = create_key(api.installation, "other", "upload")
    api.client.post(
        "/v1/robots",
        json={"name": "r", "joints": [JOINT]},
        headers={"Authorization": f"Bearer {key.secret_key}"},
    )
    (about,) = entries(api, object_id=second)
    assert about["object_ids"] == [second]
    assert [entry["action"] for entry in entries(api, key_id=key.key.id)] == ["create_robot"]
    assert entries(api, object_id="%") == entries(api, object_id=first[:-1]) == []
    at = datetime.fromisoformat(about["at"])
    assert next(e["id"] for e in entries(api, since=at.isoformat())) == about["id"]
    assert about["id"] not in [e["id"] for e in entries(api, until=at.isoformat())]
    assert about["id"] in [e["id"] for e in entries(api, until=(at + timedelta(microseconds=1)).isoformat())]
    page = api.client.get("/v1/audit", params={"limit": 1}).json()
    rest = api.client.get("/v1/audit", params={"cursor": page["next_cursor"]}).json()
    assert [*page["items"], *rest["items"]] == entries(api)
    for wrong in ({"since": "yesterday"}, {"object_id": "\0"}, {"key_id": "\n"}, {"cursor": "x"}):
        assert api.client.get("/v1/audit", params=wrong).status_code == 422


def test_rows_know_who_made_them(api: Any, grey_png: bytes) -> None:
    made = api.client.post("/v1/keys", json={"name": "cell 7", "scope": "upload"}).json()
    admin = api.client.headers["Authorization"]
    api.client.headers["Authorization"] = f"Bearer {made['key']}"
    api.client.post("/v1/robots", json={"name": "r", "joints": [JOINT]})
    session_id = api.make_session()
    api.put_image(session_id, grey_png)
    api.client.post(f"/v1/sessions/{session_id}/measured-poses", json=[READING])
    with api.installation.database.read() as records:
        for table in (Target, Robot, Session, Measurement, MeasuredPose):
            assert records.scalars(sa.select(table.made_by)).all() == [made["id"]], table
        maker = records.scalar(sa.select(ApiKey.made_by).where(ApiKey.id == made["id"]))
    api.client.headers["Authorization"] = admin
    keys = {key["id"]: key for key in api.client.get("/v1/keys").json()["items"]}
    assert keys[made["id"]]["made_by"] == maker
    assert maker in keys


def test_without_keys_changes_are_anonymous(open_api: Any) -> None:
    with open_api(auth="off") as running:
        running.make_target()
        (entry,) = entries(running)
        assert (entry["actor"], entry["key_id"], entry["client"]) == ("anonymous", None, "testclient")


def test_keys_know_when_they_were_last_used(any_api: Any) -> None:
    made = any_api.client.post("/v1/keys", json={"name": "k", "scope": "read"}).json()
    address = f"/v1/keys/{made['id']}"
    any_api.service.key_use.write()
    assert any_api.client.get(address).json()["last_used_at"] is None
    before = datetime.now(UTC)
    for _ in range(3):
        any_api.client.get("/v1/targets", headers={"Authorization": f"Bearer {made['key']}"})
    assert any_api.client.get(address).json()["last_used_at"] is None, "no request writes it"
    any_api.service.key_use.write()
    used = datetime.fromisoformat(any_api.client.get(address).json()["last_used_at"])
    assert before <= used <= datetime.now(UTC)
    assert entries(any_api, object_id=made["id"])[0]["action"] == "create_key"
    assert len(entries(any_api, object_id=made["id"])) == 1, "using a key is no change"


@pytest.mark.parametrize(("ahead", "stays"), [(timedelta(days=365), False), (timedelta(minutes=5), True)])
def test_a_use_noted_by_a_clock_that_was_ahead_gives_way_to_the_next(
    any_api: Any, ahead: timedelta, stays: bool
) -> None:
    key_id = any_api.client.get("/v1/keys").json()["items"][0]["id"]
    noted = datetime.now(UTC) + ahead
    with any_api.installation.database.write() as records:
        records.execute(sa.update(ApiKey).where(ApiKey.id == key_id).values(last_used_at=noted))
    any_api.service.key_use.note(key_id)
    any_api.service.key_use.write()
    with any_api.installation.database.read() as records:
        used = records.get_one(ApiKey, key_id).last_used_at
    assert used is not None
    assert (used == noted) is stays
    assert used <= noted


def test_the_last_use_is_not_lost_when_the_service_ends(open_api: Any) -> None:
    with open_api() as running:
        running.client.get("/v1/targets")
        folder = running.installation.settings.data_dir
    with open_api(folder) as again:
        assert any(key["last_used_at"] for key in again.client.get("/v1/keys").json()["items"])


@pytest.mark.usefixtures("restored_logging")
def test_log_lines_name_key_client_action_and_objects(api: Any, capsys: pytest.CaptureFixture[str]) -> None:
    configure_logging("info")
    target_id = api.make_target()
    api.client.get("/v1/sessions/no%0Aid")
    api.client.get("/v1/targets", headers={"Authorization": "Bearer gp_wrong"})
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    made, unknown, unauthenticated = [line for line in lines if line["event"] == "request"]
    (entry,) = entries(api, object_id=target_id)
    assert (made["action"], made["object_ids"], made["status"]) == ("create_target", [target_id], 201)
    for name in ("key_id", "client", "request_id"):
        assert made[name] == entry[name]
    assert unknown["object_ids"] == [], "what cannot be an id is not repeated"
    assert (unauthenticated["key_id"], unauthenticated["status"]) == (None, 401)
    (failed,) = [line for line in lines if line["event"] == "authentication_failed"]
    assert failed["client"] == "testclient"
    assert failed["request_id"] == unauthenticated["request_id"]


@pytest.mark.parametrize(
    ("peer", "forwarded", "expected"),
    [
        ("10.0.0.1", [], "10.0.0.1"),
        ("10.0.0.1", ["1.2.3.4"], "1.2.3.4"),
        ("10.0.0.1", ["6.6.6.6, 1.2.3.4"], "1.2.3.4"),  # the client wrote the first itself
        ("10.0.0.1", ["6.6.6.6", "1.2.3.4, 10.0.0.2"], "1.2.3.4"),
        ("10.0.0.1", ["10.0.0.3, 10.0.0.2"], "10.0.0.3"),
        ("10.0.0.1", ["nonsense"], "10.0.0.1"),
        ("10.0.0.1", ["6.6.6.6, nonsense, 10.0.0.2"], "10.0.0.2"),
        ("10.0.0.1", ["[2001:db8::1]:443"], "2001:db8::1"),
        ("10.0.0.1", ["1.2.3.4:567"], "1.2.3.4"),
        ("10.0.0.1", ["::ffff:1.2.3.4, ::ffff:10.0.0.2"], "1.2.3.4"),
        ("10.0.0.1", ["fe80::1%eth0"], "10.0.0.1"),
        ("10.0.0.1", ["[fe80::1%" + "A" * 300 + "]:443"], "10.0.0.1"),
        ("192.168.0.9", ["1.2.3.4"], "192.168.0.9"),  # no proxy of ours
        (None, ["1.2.3.4"], None),
    ],
)
def test_the_client_is_the_first_address_no_trusted_proxy_has(
    peer: str | None, forwarded: list[str], expected: str | None
) -> None:
    headers = [(b"x-forwarded-for", line.encode()) for line in forwarded]
    scope = {"type": "http", "client": (peer, 1) if peer else None, "headers": headers}
    assert client_address(scope, (ipaddress.ip_network("10.0.0.0/8"),)) == expected
    assert client_address(scope, ()) == peer


def test_a_proxy_on_a_socket_of_both_families_is_trusted_by_its_ipv4_address() -> None:
    trusted = (ipaddress.ip_network("10.0.0.0/8"),)
    scope = {
        "type": "http",
        "client": ("::ffff:10.0.0.1", 1),
        "headers": [(b"x-forwarded-for", b"1.2.3.4")],
    }
    assert client_address(scope, trusted) == "1.2.3.4"
    assert client_address(scope, ()) == "10.0.0.1"


def test_proxies_are_trusted_by_a_setting_alone(open_api: Any) -> None:
    headers = {"X-Forwarded-For": "1.2.3.4"}
    with open_api() as running:
        running.client.post("/v1/robots", json={"name": "r", "joints": [JOINT]}, headers=headers)
        assert entries(running)[-1]["client"] == "testclient"
    with pytest.raises(ValueError, match="trusted_proxies"):
        open_api(trusted_proxies="the proxy").__enter__()


@pytest.mark.usefixtures("restored_logging")
def test_a_use_that_a_busy_database_does_not_take_is_kept_and_leaves_no_trace_in_the_log(
    api: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    key_id = api.client.post("/v1/keys", json={"name": "k", "scope": "read"}).json()["id"]
    api.service.key_use.note(key_id)
    configure_logging()
    database = api.installation.database
    monkeypatch.setattr(database.engine.pool, "_timeout", 0.01)
    with database.write() as records:
        records.execute(sa.select(1))  # from here on it is occupied
        api.service.key_use.write()
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    (line,) = [line for line in lines if line["event"] == "key_use_not_written"]
    assert line["reason"] == "database_unavailable"
    assert "exception" not in line
    api.service.key_use.write()
    assert api.client.get(f"/v1/keys/{key_id}").json()["last_used_at"] is not None
