"""API keys as JSON."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.common import (
    Identifier,
    RequestModel,
    ResponseModel,
    StoredPage,
    Text,
)

KeyScope = TypeAliasType(
    "KeyScope",
    Annotated[
        Literal["read", "ingest", "upload", "admin"], Field(description="What an API key may be used for.")
    ],
)
BytesPerDay = Annotated[
    int,
    Field(
        ge=1,
        le=2**53,
    ),
]
QuotaField = Annotated[
    BytesPerDay | None,
    Field(
        description="Bytes of images the key may send from midnight to midnight UTC; beyond it, uploads are 429. Null: "
        "no quota."
    ),
]
ScopeField = Annotated[
    KeyScope,
    Field(
        description="`read`: GET. `ingest`: images, which are missing, commanded poses of existing sessions, events. "
        "`upload`: both, and to create and correct. `admin`: everything."
    ),
]


class KeyCreate(RequestModel):
    """An API key to be made."""

    name: Annotated[Text, Field(description="Whom or what the key is for.")]
    scope: ScopeField
    expires_in_days: Annotated[
        int | None, Field(description="Valid for so many days; null: until it is revoked.", ge=1, le=36500)
    ] = None
    session_ids: Annotated[
        list[Identifier] | None,
        Field(
            min_length=1,
            max_length=100,
            description="The sessions the key is limited to; all else is 404 for it. Null: no limit.",
        ),
    ] = None
    bytes_per_day: QuotaField = None


class KeyChange(RequestModel):
    """What may be changed of an API key."""

    name: Annotated[Text, Field(default_factory=str, description="Whom or what the key is for.")]
    bytes_per_day: QuotaField = None


class KeyRead(ResponseModel):
    """An API key without its secret."""

    id: Annotated[str, Field(description="Id of the key; opaque, and no secret.")]
    name: Annotated[str, Field(description="Whom or what the key is for.")]
    scope: ScopeField
    created_at: Annotated[datetime, Field(description="When the key was made, RFC 3339 in UTC.")]
    expires_at: Annotated[
        datetime | None,
        Field(description="From when on the key is not valid, RFC 3339 in UTC; null: no end."),
    ]
    revoked_at: Annotated[
        datetime | None, Field(description="When the key was revoked, RFC 3339 in UTC; null: it was not.")
    ]
    session_ids: Annotated[
        list[str] | None, Field(description="Ids of the sessions the key is limited to; null: no limit.")
    ]
    bytes_per_day: Annotated[
        int | None,
        Field(description="Image bytes it may send from midnight to midnight UTC; null: no quota."),
    ]
    bytes_today: Annotated[
        int | None,
        Field(description="Image bytes sent since midnight UTC; counted only for keys with a quota."),
    ]
    last_used_at: Annotated[
        datetime | None,
        Field(description="When the key was last used, a minute behind at most; null: never."),
    ]
    made_by: Annotated[
        str | None,
        Field(description="The key it was made with, `cli` for a command on the server; null: not known."),
    ]


class KeyCreated(KeyRead):
    """A key just made; `key` is shown this once."""

    key: Annotated[
        str, Field(description="The secret itself, for `Authorization: Bearer`. Only its hash is stored.")
    ]


class KeyPage(StoredPage):
    """One page of API keys."""

    items: Annotated[list[KeyRead], Field(description="Keys without their secrets, oldest first.")]
