"""Reports: those of a session and all of them, one with its forms, and whether it still agrees."""

from __future__ import annotations

from typing import Annotated, Any

import sqlalchemy as sa
from fastapi import Query, Request
from sqlalchemy import orm
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from app.analyses.reporting import verification
from app.errors import Conflict
from app.http import get_requester, run_while_connected
from app.records.tables import Report, Session
from app.services.queries import visible
from app.services.reports import get_report, signing_key_of
from app.web.analyses import names_in
from app.web.pages import is_fragment, page_router, render
from app.web.routes.repeatability import head_of
from app.web.service import service_of

router = page_router()
PAGE_SIZE = 50
PageNumber = Annotated[int, Query(ge=1, le=1_000_000)]
Ticked = Annotated[int | None, Query(ge=0, le=20)]
"""How many reports were ticked for a comparison of two, where they were not two."""


@router.get("/reports", operation_id="list_reports")
def show_reports(request: Request, page: PageNumber = 1, ticked: Ticked = None) -> Response:
    """Show all reports, newest first, those of deleted sessions too."""
    with service_of(request).installation.database.read() as records:
        shown = newest(records, None, page)
    shown |= {"session": None, "page_address": "/ui/reports?page=", "ticked": ticked}
    return render(request, "reports/reports.html", **shown)


@router.get("/sessions/{session_id}/reports", operation_id="list_session_reports")
def show_session_reports(
    request: Request, session_id: str, page: PageNumber = 1, ticked: Ticked = None
) -> Response:
    """Show a session's reports, newest first, and the form to order one."""
    service = service_of(request)
    with service.installation.database.read() as records:
        shown = newest(records, session_id, page)
    address = f"/ui/sessions/{session_id}/reports?page="
    if is_fragment(request):
        return render(request, "reports/_reports.html", **shown, session=session_id, page_address=address)
    context = head_of(service, session_id, "reports")
    return render(
        request, "reports/session_reports.html", **context, **shown, page_address=address, ticked=ticked
    )


@router.get("/reports/{report_id}", operation_id="get_report")
def show_report(request: Request, report_id: str) -> Response:
    """Show a report: its forms, who signs it, by which key and build it was made."""
    return render(request, "reports/report.html", **detail_of(request, report_id), found=None, refused=None)


@router.get("/reports/{report_id}/verification", operation_id="get_report_verification")
async def show_verification(request: Request, report_id: str, originals: bool = False) -> Response:
    """Show whether the report's figures, computed anew, agree: in words, with what differs."""
    service = service_of(request)
    detail = await run_in_threadpool(detail_of, request, report_id)
    found: dict[str, Any] | None = None
    refused: Conflict | None = None
    try:
        asked = verification(
            service.installation,
            service.analyses,
            await get_requester(request),
            report_id,
            with_originals=originals,
        )
        found = await run_while_connected(request, asked)
    except Conflict as error:
        refused = error
    template = "reports/_verification.html" if is_fragment(request) else "reports/report.html"
    return render(
        request,
        template,
        **detail,
        found=found,
        refused=refused,
        image_names=await input_names(request, found),
    )


async def input_names(request: Request, found: dict[str, Any] | None) -> dict[str, str]:
    """Return what is called what a verification says of its inputs: images, targets, sessions and robots."""
    if found is None:
        return {}
    inputs = [*found["unavailable_inputs"], *found["changed_inputs"]]
    differing = found["originals"]["differing"]
    return await names_in(
        request, [*(one["name"] for one in inputs), *(one["measurement_id"] for one in differing)]
    )


def detail_of(request: Request, report_id: str) -> dict[str, Any]:
    """Return what a report's page shows of it. Raises NotFound, RowUnreadable."""
    with service_of(request).installation.database.read() as records:
        detail = get_report(records, report_id)
        session = records.get(Session, detail.report.session_id)
        return {
            "report": detail.report,
            "forms": {one.form: one for one in detail.forms},
            "signing_key": signing_key_of(detail.report),
            "session": session,
            "session_id": session.id if session is not None else None,
        }


def newest(records: orm.Session, session_id: str | None, page: int) -> dict[str, Any]:
    """Return a page of reports with their sessions' names, and whether another page follows."""
    statement = (
        sa.select(Report, Session.name)
        .outerjoin(Session, Session.id == Report.session_id)
        .where(*visible(Report))
        .order_by(Report.id.desc())
        .limit(PAGE_SIZE + 1)
        .offset((page - 1) * PAGE_SIZE)
    )
    if session_id is not None:
        statement = statement.where(Report.session_id == session_id)
    rows = [(row[0], row[1]) for row in records.execute(statement)]
    return {
        "reports": rows[:PAGE_SIZE],
        "more": len(rows) > PAGE_SIZE,
        "page": page,
        "waiting": any(report.status in ("queued", "running") for report, _ in rows),
    }
