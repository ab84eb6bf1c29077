"""Webhooks: made, signed, tried again, given up and sent again."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
import sqlalchemy as sa
from typer.testing import CliRunner

from app.cli.main import app
from app.delivery.posting import signature_of
from app.records.tables import Notice, Webhook, WebhookDelivery
from app.services import notices
from app.services.notices import noting
from app.services.notices import webhooks as stored
from tests.support.service.receiver import Receiver, receiver
from tests.support.service.service import Api, ApiMaker, assert_problem, wait_until

WEBHOOK = {"name": "MES", "url": "https://plant.example/hook", "types": ["report.ready"]}


@pytest.fixture
def mes() -> Iterator[Receiver]:
    with receiver() as running:
        yield running


def make(api: Api, **changes: Any) -> dict[str, Any]:
    response = api.client.post("/v1/webhooks", json={**WEBHOOK, **changes})
    assert response.status_code == 201, response.text
    made: dict[str, Any] = response.json()
    return made


def deliveries(api: Api, webhook: dict[str, Any], **query: Any) -> list[dict[str, Any]]:
    response = api.client.get(f"/v1/webhooks/{webhook['id']}/deliveries", params=query)
    assert response.status_code == 200, response.text
    items: list[dict[str, Any]] = response.json()["items"]
    return items


def make_due(api: Api) -> None:
    with api.installation.database.write() as records:
        records.execute(
            sa.update(WebhookDelivery)
            .where(WebhookDelivery.status == "waiting")
            .values(next_attempt_at=datetime.now(UTC) - timedelta(seconds=1))
        )
    api.service.delivery.notify()


def test_a_webhook_shows_its_secret_once_and_is_audited(api: Api) -> None:
    made = make(api)
    assert made["secret"].startswith("whsec_")
    assert len(base64.b64decode(made["secret"][6:], validate=True)) == 32
    assert made["secret"] != make(api)["secret"]
    path = f"/v1/webhooks/{made['id']}"
    for answer in (api.client.get(path).json(), api.client.get("/v1/webhooks").json()["items"][0]):
        assert answer == {name: value for name, value in made.items() if name != "secret"}
    entries = api.client.get("/v1/audit", params={"object_id": made["id"]}).json()["items"]
    assert [entry["action"] for entry in entries] == ["create_webhook"]
    for method, address in (("GET", path), ("GET", "/v1/webhooks"), ("POST", f"{path}/test")):
        refused = api.client.request(method, address, headers=api.key("upload"))
        assert_problem(refused, 403, "insufficient_scope")
    assert api.client.delete(path).status_code == 204
    assert_problem(api.client.get(path), 404, "webhook_not_found")
    assert_problem(api.client.get(f"{path}/deliveries"), 404, "webhook_not_found")


def test_there_are_so_many_webhooks_at_most(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stored, "MAX_WEBHOOKS", 1)
    make(api)
    assert_problem(api.client.post("/v1/webhooks", json=WEBHOOK), 409, "too_many_webhooks")


def test_a_test_is_delivered_and_its_signature_is_over_id_time_and_body(api: Api, mes: Receiver) -> None:
    made = make(api, url=f"{mes.url}/hook?line=4")
    response = api.client.post(f"/v1/webhooks/{made['id']}/test")
    assert response.status_code == 202, response.text
    delivery_id = response.json()["id"]
    wait_until(lambda: deliveries(api, made, status="delivered") != [], 120.0, "the test is delivered")
    ((path, headers, body),) = mes.received
    assert path == "/hook?line=4"
    assert headers["webhook-id"] == delivery_id
    assert abs(int(headers["webhook-timestamp"]) - datetime.now(UTC).timestamp()) < 60
    # As a receiver does that knows Standard Webhooks and nothing of this service.
    key = base64.b64decode(made["secret"].removeprefix("whsec_"))
    signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.".encode() + body
    expected = base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()
    assert headers["webhook-signature"] == f"v1,{expected}"
    later = int(headers["webhook-timestamp"]) + 1
    assert signature_of(key, delivery_id, later, body) != headers["webhook-signature"]
    document = json.loads(body)
    assert (document["type"], document["data"]["webhook_id"]) == ("webhook.test", made["id"])
    (row,) = deliveries(api, made)
    assert (row["attempts"], row["response_status"], row["last_failure"]) == (1, 204, None)
    assert row["next_attempt_at"] is None


def test_what_fails_is_tried_again_under_the_same_id_and_redirects_are_not_followed(
    api: Api, mes: Receiver
) -> None:
    mes.statuses = [500, 302, 204]
    made = make(api, url=f"{mes.url}/hook")
    delivery_id = api.client.post(f"/v1/webhooks/{made['id']}/test").json()["id"]
    wait_until(lambda: deliveries(api, made)[0]["response_status"] == 500, 120.0, "it fails")
    (row,) = deliveries(api, made, status="waiting")
    wait = datetime.fromisoformat(row["next_attempt_at"]) - datetime.fromisoformat(row["last_attempt_at"])
    assert timedelta(seconds=9.9) <= wait <= timedelta(seconds=25)
    make_due(api)
    wait_until(lambda: deliveries(api, made)[0]["response_status"] == 302, 120.0, "it fails again")
    assert "redirects are not followed" in deliveries(api, made)[0]["last_failure"]
    make_due(api)
    wait_until(lambda: deliveries(api, made)[0]["status"] == "delivered", 120.0, "it is delivered")
    assert [headers["webhook-id"] for _, headers, _ in mes.received] == [delivery_id] * 3
    assert {path for path, _, _ in mes.received} == {"/hook"}
    again = api.client.post(f"/v1/webhooks/{made['id']}/deliveries/{delivery_id}/redeliver")
    assert again.status_code == 202
    wait_until(lambda: len(mes.received) == 4, 120.0, "it is sent again")
    assert mes.received[-1][1]["webhook-id"] == delivery_id
    absent = f"/v1/webhooks/{made['id']}/deliveries/dlv_{'0' * 26}/redeliver"
    assert_problem(api.client.post(absent), 404, "delivery_not_found")


def test_the_waits_grow_to_six_hours_and_end_after_three_days() -> None:
    waits = [notices.wait_s(attempt) for attempt in range(1, notices.ATTEMPTS)]
    assert waits[:4] == [10.0, 30.0, 90.0, 270.0]
    assert max(waits) == 6 * 3600.0
    assert 2.5 * 86400 < sum(waits) < 4 * 86400


def queue(api: Api, count: int = 1) -> str:
    """A webhook with deliveries that no thread has seen, in one transaction."""
    with api.installation.database.write() as records:
        hook = notices.create_webhook(
            records, notices.NewWebhook(name="x", url="http://127.0.0.1:9", types=[])
        )
        for _ in range(count):
            notices.test_webhook(records, hook.id)
        return hook.id


def test_what_a_killed_service_was_sending_is_sent_by_the_next(api: Api) -> None:
    api.service.delivery.stop()
    hook = queue(api)
    database, now = api.installation.database, datetime.now(UTC)
    with database.write() as records:
        (first,) = notices.claim_due(records, now)
    with database.write() as records:
        assert notices.claim_due(records, now + timedelta(seconds=30)) == [], "another service sends it"
    with database.write() as records:
        (second,) = notices.claim_due(records, now + timedelta(seconds=61))
    assert (second.delivery_id, second.attempt) == (first.delivery_id, 2)
    with database.write() as records:
        notices.save_attempt(records, first, response_status=200, failure=None)  # the first one, late
        assert records.scalars(sa.select(WebhookDelivery.status)).all() == ["waiting"]
        notices.save_attempt(records, second, response_status=200, failure=None)
        assert records.scalars(sa.select(WebhookDelivery.status)).all() == ["delivered"]
    assert hook == second.webhook_id


def test_a_clock_that_was_set_back_keeps_nothing_waiting(api: Api) -> None:
    api.service.delivery.stop()
    queue(api)
    with api.installation.database.write() as records:
        assert len(notices.claim_due(records, datetime.now(UTC) - timedelta(days=2))) == 1


def test_what_is_never_received_is_given_up(api: Api) -> None:
    api.service.delivery.stop()
    queue(api)
    database, now = api.installation.database, datetime.now(UTC)
    for attempt in range(1, notices.ATTEMPTS + 1):
        with database.write() as records:
            records.execute(sa.update(WebhookDelivery).values(next_attempt_at=now))
            (one,) = notices.claim_due(records, now)
        assert one.attempt == attempt
        with database.write() as records:
            notices.save_attempt(records, one, response_status=None, failure="away")
    with database.read() as records:
        row = records.scalars(sa.select(WebhookDelivery)).one()
        assert (row.status, row.next_attempt_at, row.failure) == ("failed", None, "away")


def test_the_queue_is_bounded_and_says_what_it_dropped(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(noting, "MAX_WAITING", 2)
    api.service.delivery.stop()
    made = make(api)
    for _ in range(3):
        with api.installation.database.write() as records:
            row = notices.note(records, "report.ready", {"report_id": "x"})
            assert row is not None
            assert notices.take_up(records, row.id)
            assert not notices.take_up(records, row.id)
    assert len(deliveries(api, made)) == 2
    assert api.client.get(f"/v1/webhooks/{made['id']}").json()["dropped"] == 1
    refused = api.client.post(f"/v1/webhooks/{made['id']}/test")
    assert_problem(refused, 409, "too_many_deliveries")
    waiting = deliveries(api, made)[0]["id"]
    refused = api.client.post(f"/v1/webhooks/{made['id']}/deliveries/{waiting}/redeliver")
    assert_problem(refused, 409, "delivery_waiting")


def test_old_notices_go_with_their_deliveries_and_what_waits_stays(api: Api) -> None:
    api.service.delivery.stop()
    queue(api, 3)
    now = datetime.now(UTC)
    with api.installation.database.write() as records:
        first = records.scalar(sa.select(sa.func.min(WebhookDelivery.id)))
        assert notices.prune(records, now) == 0
        records.execute(
            sa.update(WebhookDelivery).where(WebhookDelivery.id == first).values(status="delivered")
        )
        assert notices.prune(records, now + timedelta(days=31)) == 1
        records.expire_all()
        assert first not in records.scalars(sa.select(WebhookDelivery.id)).all()
        assert records.scalar(sa.select(sa.func.count()).select_from(Notice)) == 2


def test_an_unreadable_webhook_keeps_nothing_from_the_others(api: Api) -> None:
    api.service.delivery.stop()
    damaged, whole = make(api), make(api)
    with api.installation.database.write() as records:
        records.execute(
            sa.update(Webhook).where(Webhook.id == damaged["id"]).values(types=sa.literal_column("'half'"))
        )
    with api.installation.database.write() as records:
        row = notices.note(records, "report.ready", {})
        assert row is not None
        notices.take_up(records, row.id)
    assert len(deliveries(api, whole)) == 1
    found = api.client.get("/v1/webhooks").json()
    assert [one["id"] for one in found["items"]] == [whole["id"]]
    assert damaged["id"] in found["warnings"][0]["detail"]


def test_the_command_line_makes_tests_lists_and_deletes(serve_api: ApiMaker, mes: Receiver) -> None:
    with serve_api() as api:
        key = api.client.headers["authorization"].removeprefix("Bearer ")
        settings = {"GRIDPOSE_URL": str(api.client.base_url), "GRIDPOSE_KEY": key, "COLUMNS": "300"}

        def run(*arguments: str, code: int = 0) -> str:
            done = CliRunner().invoke(app, ["webhooks", *arguments], env=settings)
            assert done.exit_code == code, done.output
            return done.stdout

        assert "whsec_" in run("create", "MES", mes.url, "--type", "robot.alarm")
        (made,) = api.client.get("/v1/webhooks").json()["items"]
        assert made["types"] == ["robot.alarm"]
        assert made["id"] in run("list")
        assert "whsec_" not in run("list")
        assert "answered 204" in run("test", made["id"])
        assert "webhook.test" in run("deliveries", made["id"], "--status", "delivered")
        (one,) = deliveries(api, made)
        assert one["id"] in run("redeliver", made["id"], one["id"])
        mes.statuses = [500]
        run("test", made["id"], code=1)
        assert "deleted" in run("delete", made["id"])
