"""Webhooks: made, listed, deleted, tested. The secret is derived from the installation's pepper and the webhook's id,
so that no database, and no copy of one, holds it.

The form of secrets and signatures is that of Standard Webhooks (https://www.standardwebhooks.com), which receivers have
libraries for.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from urllib.parse import urlsplit

import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import Conflict, InvalidContent
from app.records.ids import new_id
from app.records.pagination import page
from app.records.tables import Notice, Webhook, WebhookDelivery
from app.services.notices.noting import queue_for
from app.services.queries import get_or_raise, require_readable

MAX_WEBHOOKS = 20
_SECRET = b"gridpose webhook secret 1\0"


@dataclass(frozen=True, slots=True, kw_only=True)
class NewWebhook:
    """What an administrator says about a webhook."""

    name: str
    url: str
    types: list[str]


def secret_of(pepper: bytes, webhook_id: str) -> bytes:
    """Return the 32 bytes that sign what is sent to a webhook."""
    return hmac.new(pepper, _SECRET + webhook_id.encode(), hashlib.sha256).digest()


def shown_secret(pepper: bytes, webhook_id: str) -> str:
    """Return the secret as its receiver is given it: `whsec_` and base64."""
    return "whsec_" + base64.b64encode(secret_of(pepper, webhook_id)).decode()


def create_webhook(records: orm.Session, new: NewWebhook) -> Webhook:
    """Store a webhook. Raises InvalidContent for an unusable address, Conflict where there are too many."""
    _require_address(new.url)
    count = records.scalar(sa.select(sa.func.count()).select_from(Webhook)) or 0
    if count >= MAX_WEBHOOKS:
        raise Conflict(
            f"There are {count} webhooks, as many as there may be.",
            "Delete one that nobody needs; one webhook may have several types.",
            code="too_many_webhooks",
        )
    row = Webhook(
        id=new_id("whk"),
        name=new.name,
        url=new.url,
        types=sorted(set(new.types)),
        created_at=datetime.now(UTC),
    )
    records.add(row)
    records.flush()
    return row


def get_webhook(records: orm.Session, webhook_id: str) -> Webhook:
    """Return a webhook. Raises NotFound."""
    return get_or_raise(records, Webhook, webhook_id)


def list_webhooks(
    records: orm.Session, *, limit: int, cursor: str | None
) -> tuple[Sequence[Webhook], str | None]:
    """Return one page of webhooks, oldest first."""
    return page(records, sa.select(Webhook), Webhook.id, limit=limit, cursor=cursor)


def delete_webhook(records: orm.Session, webhook_id: str) -> None:
    """Delete a webhook with its journal; what waits is not sent any more. Raises NotFound."""
    records.delete(get_or_raise(records, Webhook, webhook_id))


def delete_all_webhooks(records: orm.Session) -> list[str]:
    """Delete every webhook with its journal, and return their ids."""
    return sorted(records.scalars(sa.delete(Webhook).returning(Webhook.id)))


def test_webhook(records: orm.Session, webhook_id: str) -> WebhookDelivery:
    """Queue a notice for this webhook alone, whatever its types. Raises NotFound, Conflict where too many wait."""
    webhook = get_or_raise(records, Webhook, webhook_id, lock=True)
    require_readable(webhook)
    latest = records.scalar(sa.select(sa.func.max(Notice.number))) or 0
    row = Notice(
        id=new_id("ntc"),
        number=latest + 1,
        type="webhook.test",
        at=datetime.now(UTC),
        data={"webhook_id": webhook.id, "webhook_name": webhook.name},
    )
    records.add(row)
    records.flush()
    delivery = queue_for(records, webhook, row)
    if delivery is None:
        raise Conflict(
            "As many notices wait for this webhook as may.",
            "Its list of deliveries says why they cannot be delivered; delete the webhook where nobody receives them.",
            code="too_many_deliveries",
        )
    return delivery


def _require_address(url: str) -> None:
    """Raise InvalidContent for what is not http(s)://host[:port]/path, or names an address that is never sent to."""
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname, parts.port
    except ValueError:
        parts, host = urlsplit(""), None
    if parts.scheme not in ("http", "https") or not host or not url.isascii() or " " in url:
        raise _refused("must be an address such as https://plant.example/hook")
    if "@" in parts.netloc or parts.fragment:
        raise _refused("must have neither user nor password nor fragment")
    if (reason := refused_address(host)) is not None:
        raise _refused(f"names {reason}, to which nothing is sent")


def refused_address(host: str) -> str | None:
    """Return what is wrong with an IP address that nothing is sent to; None for others, and for names.

    Link-local addresses are those of the services that give a cloud's machines their credentials.
    """
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return None
    mapped = getattr(address, "ipv4_mapped", None) or address
    if mapped.is_link_local:
        return "a link-local address"
    if mapped.is_multicast or mapped.is_unspecified:
        return "a multicast or unspecified address"
    return None


def _refused(message: str) -> InvalidContent:
    return InvalidContent(
        "The address of the webhook cannot be used.",
        "Give the http or https address that is to be called.",
        errors=[("url", message)],
    )
