"""`gridpose webhooks test`, `deliveries` and `redeliver`."""

from __future__ import annotations

import time
from enum import StrEnum
from typing import Annotated, Any

import typer

from ... import ClientError, ServiceClient
from ..access import AdminAccess, act_on_each
from ..console import print_list

_POLL_S, _WITHIN_S = 0.3, 30.0
Webhook = Annotated[str, typer.Argument(help="Id of the webhook.")]


class Status(StrEnum):
    """What came of a delivery."""

    waiting = "waiting"
    delivered = "delivered"
    failed = "failed"


def test(webhook: Webhook, service: AdminAccess) -> None:
    """Send a notice to a webhook, and wait for what comes of it; ends with 1 where it was not delivered."""
    with service.connect() as client:
        made = client.create(f"/v1/webhooks/{webhook}/test", {})
        found = _attempted(client, webhook, made["id"])
        if found is None or found["status"] != "delivered":
            reason = "No attempt was made yet." if found is None else found["last_failure"]
            raise ClientError(
                "webhook_not_delivered",
                f"{made['id']} was not delivered: {reason}",
                "It is tried again for three days; `gridpose webhooks deliveries` shows what comes of it.",
            )
        print(f"{made['id']} delivered, answered {found['response_status']}")


def deliveries(
    webhook: Webhook,
    service: AdminAccess,
    status: Annotated[Status | None, typer.Option(help="Of this status alone.")] = None,
) -> None:
    """List what was sent to a webhook, or waits to be, and why it was not delivered."""
    with service.connect() as client:
        query = {} if status is None else {"status": status.value}
        rows = [
            (
                one["id"],
                one["notice_type"] or "",
                one["created_at"],
                one["status"],
                str(one["attempts"]),
                one["last_failure"] or "",
            )
            for one in client.items(f"/v1/webhooks/{webhook}/deliveries", **query)
        ]
        columns = ("id", "type", "queued", "status", "attempts", "failure")
        print_list(columns, rows, "Nothing was sent to it in the last 30 days.")


def redeliver(
    webhook: Webhook,
    service: AdminAccess,
    ids: Annotated[
        list[str] | None, typer.Argument(metavar="[DELIVERY]...", help="Ids of deliveries.")
    ] = None,
) -> None:
    """Send deliveries of a webhook again; without ids, all that failed."""
    with service.connect() as client:
        path = f"/v1/webhooks/{webhook}/deliveries"
        chosen = ids or [one["id"] for one in client.items(path, status="failed")]

        def send_one(delivery: str) -> None:
            client.create(f"{path}/{delivery}/redeliver", {})
            print(f"{delivery} is sent again")

        act_on_each(chosen, send_one, f"gridpose webhooks deliveries {webhook}")


def _attempted(client: ServiceClient, webhook: str, delivery_id: str) -> dict[str, Any] | None:
    """Return a delivery once an attempt was made; None where that takes too long."""
    deadline = time.monotonic() + _WITHIN_S
    while time.monotonic() < deadline:
        for one in client.items(f"/v1/webhooks/{webhook}/deliveries"):
            if one["id"] == delivery_id and (one["status"] != "waiting" or one["last_failure"] is not None):
                return one
        time.sleep(_POLL_S)
    return None
