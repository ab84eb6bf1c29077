"""Lists as CSV: one page of a list as a table, with a row for each item and the columns of `analysis_tables`.

What `POST` takes as CSV is written so that it can be sent again: matrices are one cell of numbers, row after row. The
next page's address is in the header `Link` (RFC 8288).
"""

from __future__ import annotations

import json
from typing import Any, TypeGuard

from fastapi import Request, Response
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool

from app.api.representations.analysis_tables import tables_of, write_table
from app.api.representations.preferences import CSV, prefers_csv

_ITEMS, _CURSOR = "items", "next_cursor"
LIST_CSV: dict[str, Any] = {
    "headers": {
        "Link": {
            "description": 'With `Accept: text/csv`: the address of the next page, `rel="next"`; absent on the last '
            "one. As JSON, `next_cursor` says it.",
            "schema": {"type": "string"},
        }
    },
    "content": {
        CSV: {
            "schema": {
                "type": "string",
                "description": "With `Accept: text/csv`: the page as a table (RFC 4180, UTF-8), a row for each item.",
            }
        }
    },
}


def is_page(model: Any) -> TypeGuard[type[BaseModel]]:
    """Return whether a response is a page of a list."""
    return (
        isinstance(model, type)
        and issubclass(model, BaseModel)
        and {_ITEMS, _CURSOR} <= model.model_fields.keys()
    )


async def page_in_form(request: Request, model: type[BaseModel], found: Response) -> Response:
    """Return a page in the form that the request prefers: as it is, or as a table."""
    if found.status_code != 200:
        return found
    found.headers.append("Vary", "Accept")
    if not prefers_csv(request.headers.get("accept")):
        return found

    def write() -> tuple[str, str | None]:
        document = json.loads(bytes(found.body))
        return write_table(tables_of(model, with_matrices=True)[_ITEMS], document), document[_CURSOR]

    text, cursor = await run_in_threadpool(write)
    name = request.url.path.rstrip("/").rpartition("/")[2]
    headers = {"Vary": "Accept", "Content-Disposition": f'inline; filename="{name}.csv"'}
    if cursor is not None:
        address = request.url.include_query_params(cursor=cursor)
        headers["Link"] = f'<{address.path}?{address.query}>; rel="next"'
    return Response(text, media_type=f"{CSV}; header=present", headers=headers)
