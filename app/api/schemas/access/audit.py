"""The audit trail as JSON."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.common import ResponseModel, StoredPage

Actor = TypeAliasType(
    "Actor",
    Annotated[
        Literal["key", "cli", "service", "anonymous"], Field(description="What kind of caller made a change.")
    ],
)


class AuditEntryRead(ResponseModel):
    """One change: who made it, from where, and of what."""

    id: Annotated[str, Field(description="The entry's id; ids are in order of time.")]
    at: Annotated[datetime, Field(description="When the change was stored.")]
    actor: Annotated[
        Actor,
        Field(
            description="`key`: a request with an API key. `cli`: a command on the server. `service`: the service of "
            "its own accord. `anonymous`: a request to a service without keys (GRIDPOSE_AUTH=off)."
        ),
    ]
    key_id: Annotated[str | None, Field(description="The key the request came with.")]
    key_name: Annotated[str | None, Field(description="The key's name at that time.")]
    client: Annotated[
        str | None, Field(description="The client's address; behind a proxy only where that one is trusted.")
    ]
    action: Annotated[str, Field(description="The `operationId` of the request, or what a command did.")]
    object_ids: Annotated[
        list[str],
        Field(
            description="Ids and pose tags in the address, then what was changed with them, then what was made."
        ),
    ]
    request_id: Annotated[str | None, Field(description="The `X-Request-ID` of the answer, also in the log.")]


class AuditPage(StoredPage):
    """One page of entries."""

    items: Annotated[list[AuditEntryRead], Field(description="Entries, oldest first.")]
