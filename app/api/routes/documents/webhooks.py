"""/v1/webhooks: who is notified by HTTP of what happens, and the journal of that"""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Response
from sqlalchemy import orm

from app.api.dependencies import AppContextDep, Cursor, DeliveryPath, Limit, WebhookPath
from app.api.responses import stored_document, stored_documents
from app.api.routing import api_router, problem_responses
from app.api.schemas.documents.webhooks import (
    DeliveryStatus,
    WebhookCreate,
    WebhookCreated,
    WebhookDeliveryPage,
    WebhookDeliveryRead,
    WebhookPage,
    WebhookRead,
)
from app.records.tables import Webhook, WebhookDelivery
from app.services import notices

router = api_router(prefix="/v1/webhooks", tags=["webhooks"])


@router.post("", status_code=201, responses=problem_responses(409, 413, 415, 507))
def create_webhook(body: WebhookCreate, service: AppContextDep, response: Response) -> WebhookCreated:
    """Make a webhook: an address that notices are sent to, signed; its secret is in this answer and never again."""
    with service.installation.database.write() as records:
        row = notices.create_webhook(records, notices.NewWebhook(**body.model_dump()))
    response.headers["Location"] = f"/v1/webhooks/{row.id}"
    secret = notices.shown_secret(service.installation.pepper, row.id)
    return WebhookCreated(**_document(row).model_dump(), secret=secret)


@router.get("", responses=problem_responses())
def list_webhooks(service: AppContextDep, limit: Limit = 50, cursor: Cursor = None) -> WebhookPage:
    """List webhooks without their secrets, oldest first."""
    with service.installation.database.read() as records:
        rows, next_cursor = notices.list_webhooks(records, limit=limit, cursor=cursor)
    items, warnings = stored_documents(_document, rows, lambda row: row.id)
    return WebhookPage(items=items, next_cursor=next_cursor, warnings=warnings)


@router.get("/{webhook_id}", responses=problem_responses(404, 409))
def get_webhook(webhook_id: WebhookPath, service: AppContextDep) -> WebhookRead:
    """Return one webhook without its secret."""
    with service.installation.database.read() as records:
        return _document(notices.get_webhook(records, webhook_id))


@router.delete(
    "/{webhook_id}", status_code=204, response_class=Response, responses=problem_responses(404, 507)
)
def delete_webhook(webhook_id: WebhookPath, service: AppContextDep) -> None:
    """Delete a webhook with its journal; what waits is not sent any more."""
    with service.installation.database.write() as records:
        notices.delete_webhook(records, webhook_id)


@router.post("/{webhook_id}/test", status_code=202, responses=problem_responses(404, 409, 507))
def create_webhook_test(
    webhook_id: WebhookPath, service: AppContextDep, response: Response
) -> WebhookDeliveryRead:
    """Queue a notice `webhook.test` for this webhook alone; its journal says what comes of it."""
    with service.installation.database.write() as records:
        row = notices.test_webhook(records, webhook_id)
        found = _deliveries(records, [row])[0]
    service.delivery.notify()
    response.headers["Location"] = f"/v1/webhooks/{webhook_id}/deliveries"
    return found


@router.get("/{webhook_id}/deliveries", responses=problem_responses(404))
def list_webhook_deliveries(
    webhook_id: WebhookPath,
    service: AppContextDep,
    status: Annotated[DeliveryStatus | None, Query(description="Of this status alone.")] = None,
    limit: Limit = 50,
    cursor: Cursor = None,
) -> WebhookDeliveryPage:
    """List what was sent to a webhook in the last 30 days, or waits to be, oldest first."""
    with service.installation.database.read() as records:
        rows, next_cursor = notices.list_deliveries(records, webhook_id, status, limit=limit, cursor=cursor)
        types = notices.types_of(records, rows)
    items, warnings = stored_documents(lambda row: _delivery(row, types), rows, lambda row: row.id)
    return WebhookDeliveryPage(items=items, next_cursor=next_cursor, warnings=warnings)


@router.post(
    "/{webhook_id}/deliveries/{delivery_id}/redeliver",
    status_code=202,
    responses=problem_responses(404, 409, 507),
)
def create_webhook_redelivery(
    webhook_id: WebhookPath, delivery_id: DeliveryPath, service: AppContextDep, response: Response
) -> WebhookDeliveryRead:
    """Send a delivery again under its id, whatever came of it."""
    with service.installation.database.write() as records:
        row = notices.redeliver(records, webhook_id, delivery_id)
        found = _deliveries(records, [row])[0]
    service.delivery.notify()
    response.headers["Location"] = f"/v1/webhooks/{webhook_id}/deliveries"
    return found


def _deliveries(records: orm.Session, rows: list[WebhookDelivery]) -> list[WebhookDeliveryRead]:
    types = notices.types_of(records, rows)
    return [_delivery(row, types) for row in rows]


def _delivery(row: WebhookDelivery, types: dict[str, str]) -> WebhookDeliveryRead:
    other = {"notice_type": types.get(row.notice_id), "last_failure": row.failure}
    names = [name for name in WebhookDeliveryRead.model_fields if name not in other]
    shown = {name: getattr(row, name) for name in names}
    return stored_document(WebhookDeliveryRead, {**shown, **other}, "delivery")


def _document(row: Webhook) -> WebhookRead:
    return stored_document(WebhookRead, row, "webhook")
