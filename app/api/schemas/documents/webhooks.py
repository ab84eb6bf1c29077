"""Webhooks and their deliveries as JSON."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.common import RequestModel, ResponseModel, StoredPage, Text
from app.services import notices

NoticeType = TypeAliasType(
    "NoticeType",
    Annotated[notices.NoticeType, Field(description="What happened, as docs/notices.md lists it.")],
)
DeliveryStatus = TypeAliasType(
    "DeliveryStatus",
    Annotated[
        Literal["waiting", "delivered", "failed"],
        Field(
            description="`waiting`: for an attempt. `delivered`: the receiver answered 2xx. `failed`: given up after "
            "18 attempts over three days."
        ),
    ],
)
_NAME = "Whom or what it is for."
_URL = (
    "The http or https address that is called, without user, password and fragment. Redirects are not followed; "
    "link-local addresses are refused."
)
_TYPES = "The types of notices that are sent to it."


class WebhookCreate(RequestModel):
    """A webhook to be made."""

    name: Annotated[Text, Field(description=_NAME)]
    url: Annotated[
        str, Field(min_length=1, max_length=2000, description=_URL, examples=["https://plant.example/hook"])
    ]
    types: Annotated[list[NoticeType], Field(min_length=1, max_length=20, description=_TYPES)]


class WebhookRead(ResponseModel):
    """A webhook without its secret."""

    id: Annotated[str, Field(description="Id of the webhook; opaque, made by the server.")]
    name: Annotated[str, Field(description=_NAME)]
    url: Annotated[str, Field(description=_URL)]
    types: Annotated[list[NoticeType], Field(description=_TYPES)]
    created_at: Annotated[datetime, Field(description="When it was made, RFC 3339 in UTC.")]
    dropped: Annotated[
        int, Field(description="Notices that were not queued since 1,000 deliveries waited already.")
    ]


class WebhookCreated(WebhookRead):
    """A webhook just made; `secret` is shown this once."""

    secret: Annotated[
        str,
        Field(
            description="What signs each request by HMAC-SHA256, `whsec_` and 32 bytes in base64. It is stored nowhere."
        ),
    ]


class WebhookPage(StoredPage):
    """One page of webhooks."""

    items: Annotated[list[WebhookRead], Field(description="Webhooks without their secrets, oldest first.")]


class WebhookDeliveryRead(ResponseModel):
    """One notice for one webhook, and what came of it."""

    id: Annotated[
        str,
        Field(
            description="Id of the delivery, the same at every attempt (header `webhook-id`): a receiver that has it "
            "already has the notice."
        ),
    ]
    webhook_id: Annotated[str, Field(description="Id of the webhook.")]
    notice_id: Annotated[str, Field(description="Id of the notice.")]
    notice_type: Annotated[
        str | None,
        Field(description="Type of the notice, `webhook.test` for a test; null where it cannot be read."),
    ]
    status: Annotated[DeliveryStatus, Field(description="What came of it so far.")]
    attempts: Annotated[int, Field(description="Attempts so far, since it was queued or queued again.")]
    created_at: Annotated[datetime, Field(description="When it was queued, RFC 3339 in UTC.")]
    last_attempt_at: Annotated[
        datetime | None, Field(description="When the last attempt began, RFC 3339 in UTC; null: none did.")
    ]
    next_attempt_at: Annotated[
        datetime | None,
        Field(description="When the next attempt is due, RFC 3339 in UTC; null: no attempt is due."),
    ]
    response_status: Annotated[
        int | None, Field(description="The status that the receiver answered last; null: no answer.")
    ]
    last_failure: Annotated[
        str | None, Field(description="Why the last attempt did not deliver it; null where it did.")
    ]


class WebhookDeliveryPage(StoredPage):
    """One page of a webhook's journal."""

    items: Annotated[list[WebhookDeliveryRead], Field(description="Deliveries, oldest first.")]
