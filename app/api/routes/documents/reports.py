"""/v1/reports: stored reports of sessions, their forms, signature and verification"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Query, Request, Response

from app.analyses.reporting import verification
from app.api.dependencies import AppContext, AppContextDep, Cursor, Limit, ReportPath, SessionPath
from app.api.representations import binary_content, stated_media_type
from app.api.responses import stored_document, stored_documents
from app.api.routing import api_router, problem_responses
from app.api.schemas.documents.reports import ReportCreate, ReportPage, ReportRead, ReportVerification
from app.http import RequesterDep, run_while_connected
from app.services import reports
from app.services.reports import ReportDetail

router = api_router(prefix="/v1", tags=["reports"])
MEDIA_TYPES = {
    "json": "application/json",
    "html": "text/html; charset=utf-8",
    "pdf": "application/pdf",
    "csv": "text/csv; charset=utf-8; header=present",
    "xml": "application/xml",
    "sig": "application/json",
}
SessionQuery = Annotated[
    str | None, Query(max_length=40, description="Reports of this session alone, which may be deleted.")
]


def _responses(media_type: str, description: str) -> dict[int | str, dict[str, Any]]:
    schema: dict[str, Any] = {"type": "string", "description": description}
    content = {media_type: {"schema": schema}}
    if media_type == MEDIA_TYPES["pdf"]:
        content = binary_content(media_type)
    elif media_type == "application/json":
        schema |= {"type": "object", "additionalProperties": True}
    return {
        200: {"description": description, "content": content},
        **problem_responses(404, 409),
    }


@router.post(
    "/sessions/{session_id}/reports",
    status_code=202,
    responses=problem_responses(404, 409, 413, 415, 507),
)
def create_report(
    session_id: SessionPath, body: ReportCreate, service: AppContextDep, response: Response
) -> ReportRead:
    """Order a report of a session as it is now; it is made from stored values, then never changes."""
    fields = body.model_dump()
    with service.installation.database.write() as records:
        detail = reports.order_report(records, session_id, reports.NewReport(**fields))
    service.report_maker.notify()
    response.headers["Location"] = f"/v1/reports/{detail.report.id}"
    return _document(detail)


@router.get("/sessions/{session_id}/reports", responses=problem_responses(404))
def list_session_reports(
    session_id: SessionPath, service: AppContextDep, limit: Limit = 50, cursor: Cursor = None
) -> ReportPage:
    """List a session's reports, oldest first."""
    return _page(service, session_id, limit, cursor)


@router.get("/reports", responses=problem_responses())
def list_reports(
    service: AppContextDep, session_id: SessionQuery = None, limit: Limit = 50, cursor: Cursor = None
) -> ReportPage:
    """List all reports, oldest first, those of deleted sessions too."""
    return _page(service, session_id, limit, cursor)


@router.get(
    "/reports/{report_id}.json",
    response_class=Response,
    responses=_responses("application/json", "All figures, and what they were made from (docs/reports.md)."),
)
def get_report_json(report_id: ReportPath, service: AppContextDep) -> Response:
    """Return a report as JSON: analyses, inputs with their hashes, subject and provenance."""
    return _form(service, report_id, "json")


@router.get(
    "/reports/{report_id}.html",
    response_class=Response,
    responses=_responses("text/html", "A page that needs no other file."),
)
def get_report_html(report_id: ReportPath, service: AppContextDep) -> Response:
    """Return a report as one HTML page with its drawings in it."""
    return _form(service, report_id, "html")


@router.get(
    "/reports/{report_id}.pdf",
    response_class=Response,
    responses=_responses("application/pdf", "PDF/A-3a and PDF/UA-1, with the JSON form attached."),
)
def get_report_pdf(report_id: ReportPath, request: Request, service: AppContextDep) -> Response:
    """Return a report as PDF, to be filed and signed."""
    response = _form(service, report_id, "pdf")
    response.headers["content-type"] = stated_media_type(request.headers.get("accept"), MEDIA_TYPES["pdf"])
    return response


@router.get(
    "/reports/{report_id}.csv",
    response_class=Response,
    responses=_responses("text/csv", "A row for each figure: analysis, figure, value, unit."),
)
def get_report_csv(report_id: ReportPath, service: AppContextDep) -> Response:
    """Return every figure of a report as one CSV table."""
    return _form(service, report_id, "csv")


@router.get(
    "/reports/{report_id}.xml",
    response_class=Response,
    responses=_responses(
        "application/xml", "A Digital Calibration Certificate (DCC 3.2.0) with quantities in D-SI."
    ),
)
def get_report_xml(report_id: ReportPath, service: AppContextDep) -> Response:
    """Return a report as a Digital Calibration Certificate; reports on a whole session have none."""
    return _form(service, report_id, "xml")


@router.get(
    "/reports/{report_id}.sig",
    response_class=Response,
    responses=_responses(
        "application/json", "The manifest with each form's SHA-256, and its Ed25519 signature."
    ),
)
def get_report_signature(report_id: ReportPath, service: AppContextDep) -> Response:
    """Return a report's detached signature, which `gridpose report verify FILE` compares with a form."""
    with service.installation.database.read() as records:
        content = reports.read_signature(records, report_id)
    return _file(report_id, "sig", content)


@router.get(
    "/reports/{report_id}/verify",
    response_model=ReportVerification,
    responses=problem_responses(404, 409),
)
async def get_report_verification(
    report_id: ReportPath,
    request: Request,
    service: AppContextDep,
    requester: RequesterDep,
    originals: Annotated[
        bool,
        Query(
            description="Measure the originals anew, too; `false` computes from the stored grid points alone."
        ),
    ] = True,
) -> dict[str, Any]:
    """Compute a report's figures again from what it was made from, and say whether every one agrees."""
    return await run_while_connected(
        request,
        verification(service.installation, service.analyses, requester, report_id, with_originals=originals),
    )


@router.get("/reports/{report_id}", responses=problem_responses(404, 409))
def get_report(report_id: ReportPath, service: AppContextDep) -> ReportRead:
    """Return how far a report is, and the hashes of its forms."""
    with service.installation.database.read() as records:
        return _document(reports.get_report(records, report_id))


def _form(service: AppContext, report_id: str, form: str) -> Response:
    with service.installation.database.read() as records:
        content, _ = reports.read_form(records, report_id, form)
    return _file(report_id, form, content)


def _file(report_id: str, form: str, content: bytes) -> Response:
    headers = {
        "Content-Disposition": f'inline; filename="{report_id}.{form}"',
        "Cache-Control": "private, max-age=31536000, immutable",
    }
    return Response(content, media_type=MEDIA_TYPES[form], headers=headers)


def _page(service: AppContext, session_id: str | None, limit: int, cursor: str | None) -> ReportPage:
    with service.installation.database.read() as records:
        views, next_cursor = reports.list_reports(records, session_id, limit=limit, cursor=cursor)
    items, warnings = stored_documents(_document, views, lambda view: view.report.id)
    return ReportPage(items=items, next_cursor=next_cursor, warnings=warnings)


def _document(view: ReportDetail) -> ReportRead:
    report = view.report
    return stored_document(
        ReportRead,
        {
            **{name: getattr(report, name) for name in _PLAIN},
            "signing_key": reports.signing_key_of(report),
            "forms": view.forms,
        },
        "report",
    )


_PLAIN = (
    *("id", "session_id", "kind", "title", "signatories", "paper", "status", "failure", "created_at"),
    *("finished_at", "made_by", "made_by_name", "core_version", "inputs_sha256"),
)
