"""Analyses as answers: JSON, or one of their tables as CSV, and whether the client has the answer already."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Header, Query, Request, Response
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool

from app.api.dependencies import get_app_context
from app.api.representations.analysis_tables import Table, tables_of, write_table
from app.api.representations.preferences import CSV, prefers_csv
from app.errors import InvalidContent
from app.http import get_requester, run_while_connected

KnownTags = Annotated[
    str | None,
    Header(
        alias="If-None-Match",
        max_length=4096,
        description="Entity tags (`ETag`) of answers that the client has, separated by commas; 304 if one is "
        "still valid.",
    ),
]


@dataclass
class TableForm:
    """In what form a client wants an analysis."""

    accept: Annotated[
        str | None,
        Header(
            alias="Accept",
            max_length=1000,
            description="`text/csv` for one table of the analysis; otherwise the answer is JSON.",
        ),
    ] = None
    table: Annotated[
        str | None,
        Query(
            max_length=64,
            pattern=r"^[a-z_.]+$",
            description="With `Accept: text/csv`: which table, by the lists' names in the JSON, such as "
            "`poses.outliers`; `summary` is one row of all that is in no list.",
        ),
    ] = None


@dataclass
class AnswerForm(TableForm):
    """In what form a client wants an analysis that it reads, and which answers it has."""

    known: KnownTags = None


FormDep = Annotated[AnswerForm, Depends()]
PostedFormDep = Annotated[TableForm, Depends()]
"""Of an analysis by POST: what a client has already is no condition there (RFC 9110, 13.1.2)."""

ETAG_HEADER = {
    "ETag": {"description": "Changes with what the answer is computed from.", "schema": {"type": "string"}}
}

CSV_CONTENT: dict[str, Any] = {
    CSV: {
        "schema": {
            "type": "string",
            "description": "With `Accept: text/csv`: the table that `table` names (RFC 4180, UTF-8), its "
            "numbers those of the JSON. docs/results.md lists the tables.",
        }
    }
}
_WITH_MATRICES = frozenset({"next_view"})
"""Analyses whose rows say nothing without their matrices, in one cell, row after row."""
POSTED_ANALYSIS: dict[int | str, dict[str, Any]] = {200: {"headers": ETAG_HEADER, "content": CSV_CONTENT}}
DEFAULT_TABLES = {
    "intrinsics": "groups",
    "repeatability": "poses",
    "camera_poses": "camera_poses",
    "hand_eye": "summary",
    "joint_noise": "joint_noise",
    "dh": "joints",
    "kinematic_error": "error_map.error_cells",
    "comparison": "calibrations",
    "compensation": "poses",
    "qualification": "lengths",
    "next_view": "suggestions",
    "dh_plan": "joints",
    "history": "session_figures",
    "report_comparison": "compared_figures",
}


async def answer_in_form(
    request: Request,
    analysis: str,
    model: type[BaseModel],
    session_id: str,
    settings: dict[str, str],
    form: TableForm,
) -> Response:
    """Answer with an analysis as JSON, or with one of its tables as CSV."""
    name, table = _chosen(analysis, model, form)
    known = _known(form)
    if not prefers_csv(form.accept):
        found = await answer_analysis(request, analysis, session_id, settings, known)
        found.headers["Vary"] = "Accept"
        return found
    found = await answer_analysis(request, analysis, session_id, settings, _tags_of_document(known, name))
    headers = {
        "ETag": f'{found.headers["ETag"][:-1]}-{name}"',
        "Cache-Control": found.headers["Cache-Control"],
        "Vary": "Accept",
    }
    if found.status_code == 304:
        return Response(status_code=304, headers=headers)
    headers["Content-Disposition"] = f'inline; filename="{analysis}-{name}.csv"'
    text = await run_in_threadpool(lambda: write_table(table, json.loads(bytes(found.body))))
    return Response(text, media_type=f"{CSV}; header=present", headers=headers)


def answer_document(
    name: str, model: type[BaseModel], document: Mapping[str, Any], form: TableForm
) -> Response:
    """Answer with a document whose numbers are rounded as JSON, or with one of its tables as CSV."""
    table_name, table = _chosen(name, model, form)
    body = json.dumps(document, allow_nan=False, ensure_ascii=False, separators=(",", ":")).encode()
    as_csv = prefers_csv(form.accept)
    tag = hashlib.sha256(body).hexdigest()[:32]
    headers = {
        "ETag": f'"{tag}-{table_name}"' if as_csv else f'"{tag}"',
        "Cache-Control": "private, no-cache",
        "Vary": "Accept",
    }
    if {headers["ETag"], "*"} & _entity_tags(_known(form)):
        return Response(status_code=304, headers=headers)
    if not as_csv:
        return Response(body, media_type="application/json", headers=headers)
    headers["Content-Disposition"] = f'inline; filename="{name}-{table_name}.csv"'
    text = write_table(table, json.loads(body))
    return Response(text, media_type=f"{CSV}; header=present", headers=headers)


def _known(form: TableForm) -> str | None:
    """Return the tags of the answers that the client has; None where they are no condition."""
    return form.known if isinstance(form, AnswerForm) else None


def _chosen(analysis: str, model: type[BaseModel], form: TableForm) -> tuple[str, Table]:
    """Return the table that is asked for, or the default one, with its name. Raises InvalidContent."""
    tables = tables_of(model, with_matrices=analysis in _WITH_MATRICES)
    name = form.table or DEFAULT_TABLES[analysis]
    if name not in tables:
        raise InvalidContent(
            "The analysis has no such table.",
            f"Ask for one of {', '.join(tables)}.",
            code="unknown_table",
            errors=[("table", "names no table of this analysis")],
        )
    return name, tables[name]


def _tags_of_document(known: str | None, table: str) -> str | None:
    """Return the tags of documents whose table the client has: a table's tag is the document's with its name."""
    suffix = f'-{table}"'
    tags = _entity_tags(known)
    found = [f'{tag.removesuffix(suffix)}"' for tag in sorted(tags) if tag.endswith(suffix)]
    return ",".join([*found, *({"*"} & tags)]) or None


async def answer_analysis(
    request: Request,
    analysis: str,
    session_id: str,
    settings: dict[str, str],
    known: str | None,
    media_type: str = "application/json",
) -> Response:
    """Answer with a document of the analysis service, or that the client has it; a client that leaves ends its own."""
    service = await get_app_context(request)
    requester = await get_requester(request)
    asked = service.analyses.answer(analysis, session_id, settings, _entity_tags(known), requester)
    answer = await run_while_connected(request, asked)
    headers = {"ETag": answer.etag, "Cache-Control": "private, no-cache"}
    if answer.body is None:
        return Response(status_code=304, headers=headers)
    return Response(answer.body, media_type=media_type, headers=headers)


def answer_drawing(drawn: bytes, media_type: str, known: str | None) -> Response:
    """Answer with a drawing under the tag of its bytes, or 304 to who has it."""
    tag = f'"{hashlib.sha256(drawn).hexdigest()[:32]}"'
    headers = {"ETag": tag, "Vary": "Accept", "Cache-Control": "private, no-cache"}
    if {tag, "*"} & _entity_tags(known):
        return Response(status_code=304, headers=headers)
    return Response(drawn, media_type=media_type, headers=headers)


def _entity_tags(known: str | None) -> frozenset[str]:
    """Return the tags of an If-None-Match header; weak ones compare as strong ones do (RFC 9110, 13.1.2)."""
    if known is None:
        return frozenset()
    return frozenset(tag.strip().removeprefix("W/") for tag in known.split(","))
