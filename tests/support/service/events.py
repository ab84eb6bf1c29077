"""Events of a session as a client reads them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, NamedTuple


class Event(NamedTuple):
    """One server-sent event."""

    name: str
    id: str | None
    data: dict[str, Any]


def read_events(response: Any) -> Iterator[Event]:
    """Yield the events of an open stream. One that is silent until it says that it is still there lacks an event."""
    fields: dict[str, str] = {}
    for line in response.iter_lines():
        assert not line.startswith(":"), "no event came"
        if line:
            name, _, value = line.partition(": ")
            fields[name] = value
        elif fields:
            yield Event(fields["event"], fields.get("id"), json.loads(fields["data"]))
            fields = {}
