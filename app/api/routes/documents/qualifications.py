"""/v1/qualifications: records of what known lengths showed of a set-up"""

from __future__ import annotations

import json
from typing import Annotated, Any

from fastapi import Path, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from app.analyses.documents.qualification import control_document
from app.api.dependencies import AppContextDep, Cursor, Limit, SessionPath
from app.api.representations import answer_analysis
from app.api.responses import stored_document, stored_documents
from app.api.routing import api_router, problem_responses
from app.api.schemas.analyses import QualificationCreate
from app.api.schemas.documents.qualifications import (
    QualificationDetail,
    QualificationPage,
    QualificationRead,
    QualificationRecordCreate,
)
from app.records.tables import Qualification
from app.services import qualifications

router = api_router(prefix="/v1", tags=["qualifications"])
QualificationPath = Annotated[str, Path(description="Id of a qualification, as lists and answers show it.")]
RobotQuery = Annotated[
    str | None, Query(max_length=40, description="Records of this robot alone, which may be deleted.")
]


def qualification_settings(body: QualificationCreate) -> dict[str, str]:
    """Return the settings of the analysis by these known lengths."""
    fields = body.model_dump()
    return {
        "estimator": body.estimator,
        "source": body.source,
        "lengths": json.dumps(fields["lengths"]),
        "maximum_permissible_error_mm": json.dumps(body.maximum_permissible_error_mm),
    }


@router.post(
    "/sessions/{session_id}/qualifications",
    status_code=201,
    responses=problem_responses(404, 409, 413, 415, 507),
)
async def create_qualification_record(
    session_id: SessionPath,
    body: QualificationRecordCreate,
    service: AppContextDep,
    request: Request,
    response: Response,
) -> QualificationDetail:
    """Compare known lengths with what the session measured of them, and keep the result for good.

    It is a record of the session's robot, or of the installation where the session has none. Analyses and reports cite
    the latest record in `subject`, until when it holds, and its decision.
    """
    found = await answer_analysis(request, "qualification", session_id, qualification_settings(body), None)
    analysis = json.loads(bytes(found.body))

    def store() -> QualificationDetail:
        with service.installation.database.write() as records:
            detail = qualifications.store_qualification(
                records, session_id, analysis, valid_days=body.valid_days, camera_name=body.camera_name
            )
            return _detail(detail)

    stored = await run_in_threadpool(store)
    response.headers["Location"] = f"/v1/qualifications/{stored.id}"
    return stored


@router.get("/qualifications", responses=problem_responses())
def list_qualifications(
    service: AppContextDep, robot_id: RobotQuery = None, limit: Limit = 50, cursor: Cursor = None
) -> QualificationPage:
    """List qualifications, oldest first, those of deleted sessions and robots too."""
    with service.installation.database.read() as records:
        rows, next_cursor = qualifications.list_qualifications(
            records, robot_id=robot_id, limit=limit, cursor=cursor
        )
        items, warnings = stored_documents(
            lambda row: stored_document(QualificationRead, _plain(row), "qualification"),
            rows,
            lambda row: row.id,
        )
    return QualificationPage(items=items, next_cursor=next_cursor, warnings=warnings)


@router.get("/qualifications/{qualification_id}", responses=problem_responses(404, 409))
def get_qualification(qualification_id: QualificationPath, service: AppContextDep) -> QualificationDetail:
    """Return one qualification with its analysis, compared with the earlier ones of the same robot and camera."""
    with service.installation.database.read() as records:
        return _detail(qualifications.get_qualification(records, qualification_id))


def _plain(row: Qualification) -> dict[str, Any]:
    return {name: getattr(row, name) for name in QualificationRead.model_fields}


def _detail(detail: qualifications.QualificationDetail) -> QualificationDetail:
    row = detail.row
    control = {
        f"control_{name}": control_document(name, values, getattr(row, name))
        for name, values in detail.earlier.items()
    }
    return stored_document(
        QualificationDetail, {**_plain(row), **control, "analysis": row.analysis}, "qualification"
    )
