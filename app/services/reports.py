"""Reports of sessions: ordered, claimed, saved once, listed, read.

The row is the queue, as for measurements. A report is saved with all of its forms and its signature in one
transaction; from then on nothing changes it. A restart counts no attempt.
"""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import Conflict, NotFound, RowUnreadable
from app.records.activity import maker_name
from app.records.ids import new_id
from app.records.pagination import page
from app.records.tables import Report, ReportForm, Session
from app.services.notices import note, of_session
from app.services.queries import get_or_raise, require_readable, visible

MAX_ATTEMPTS = 3
MAX_WAITING = 100
"""Reports of one session that wait to be made."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NewReport:
    """What a client says about a report."""

    kind: str
    title: str | None
    signatories: list[dict[str, str | None]]
    paper: str


@dataclass(frozen=True, slots=True)
class FormSummary:
    """A form of a report, without its bytes; `sha256` is of these."""

    form: str
    sha256: str
    bytes: int


@dataclass(frozen=True, slots=True)
class ReportDetail:
    """A report and the forms it has."""

    report: Report
    forms: tuple[FormSummary, ...]


def order_report(records: orm.Session, session_id: str, new: NewReport) -> ReportDetail:
    """Store that a report of a session is to be made. Raises NotFound, Conflict where too many wait."""
    session = get_or_raise(records, Session, session_id, lock=True)
    require_readable(session)
    waiting = records.scalar(
        sa.select(sa.func.count()).where(
            Report.session_id == session_id, Report.status.in_(("queued", "running"))
        )
    )
    if (waiting or 0) >= MAX_WAITING:
        raise Conflict(
            f"{waiting} reports of this session wait to be made.",
            "Wait until some of them are made; the session's list of reports shows them.",
            code="too_many_reports",
        )
    report = Report(
        id=new_id("rep"),
        session_id=session_id,
        kind=new.kind,
        title=new.title or f"{new.kind.capitalize()} of {session.name}"[:200],
        signatories=new.signatories,
        paper=new.paper,
        status="queued",
        attempts=0,
        failure=None,
        created_at=datetime.now(UTC),
        made_by_name=maker_name(),
        signature=None,
    )
    records.add(report)
    return ReportDetail(report, ())


def get_report(records: orm.Session, report_id: str) -> ReportDetail:
    """Return a report with its forms. Raises NotFound."""
    report = get_or_raise(records, Report, report_id)
    return ReportDetail(report, _forms(records, [report_id]).get(report_id, ()))


def list_reports(
    records: orm.Session, session_id: str | None, *, limit: int, cursor: str | None
) -> tuple[list[ReportDetail], str | None]:
    """Return one page of reports, oldest first: of one session, which may be deleted, or of all."""
    statement = sa.select(Report).where(*visible(Report))
    if session_id is not None:
        statement = statement.where(Report.session_id == session_id)
    rows, next_cursor = page(records, statement, Report.id, limit=limit, cursor=cursor)
    forms = _forms(records, [row.id for row in rows])
    return [ReportDetail(row, forms.get(row.id, ())) for row in rows], next_cursor


def read_form(records: orm.Session, report_id: str, form: str) -> tuple[bytes, str]:
    """Return the bytes of a form and their SHA-256, verified.

    Raises NotFound, Conflict where the report is not made or lacks the form, RowUnreadable where it was damaged.
    """
    report = get_or_raise(records, Report, report_id)
    require_made(report)
    row = records.get(ReportForm, (report_id, form))
    if row is None:
        raise NotFound(
            f"This report has no form {form}.",
            "Ask for one of the forms that the report lists.",
            code="report_form_not_found",
        )
    content = inflated(row)
    if content is None:
        raise RowUnreadable(f"report ({report_id})", [f"content of {form}"])
    return content, row.sha256


def read_signature(records: orm.Session, report_id: str) -> bytes:
    """Return a report's detached signature as a file. Raises as `read_form` does."""
    report = get_or_raise(records, Report, report_id)
    require_made(report)
    if report.signature is None:
        raise RowUnreadable(f"report ({report_id})", ["signature"])
    return signature_file(report.signature)


def signature_file(signature: Mapping[str, Any]) -> bytes:
    """Return a signature as the file that is saved alongside a form."""
    return (json.dumps(signature, indent=1, sort_keys=True) + "\n").encode()


def signing_key_of(report: Report) -> str | None:
    """Return the fingerprint of the key that signed a report, 64 hex digits; None before it is made."""
    if report.signature is None:
        return None
    try:
        return hashlib.sha256(base64.b64decode(report.signature["public_key"], validate=True)).hexdigest()
    except (ValueError, KeyError, TypeError) as error:
        raise RowUnreadable(f"report ({report.id})", ["signature"]) from error


def inflated(row: ReportForm | sa.Row[Any]) -> bytes | None:
    """Return the bytes of a stored form; None where they are not those that were stored."""
    try:
        content = zlib.decompress(row.content)
    except (zlib.error, TypeError):
        return None
    return content if hashlib.sha256(content).hexdigest() == row.sha256 else None


def require_made(report: Report) -> None:
    """Raise Conflict for a report that is not made, and may never be; RowUnreadable for a damaged one."""
    require_readable(report)
    if report.status == "succeeded":
        return
    if report.status == "failed" and report.failure is not None:
        raise Conflict(
            f"The report could not be made: {report.failure['detail']}",
            report.failure["advice"],
            code=report.failure["code"],
        )
    raise Conflict("The report is not made yet.", "Ask again shortly.", code="report_not_made")


def requeue_interrupted(records: orm.Session, *, before: datetime | None = None) -> int:
    """Queue again what a process that ended was making; it counts no attempt.

    With `before`, what was begun before it: other services of the installation may be making the rest.
    """
    statement = sa.update(Report).where(Report.status == "running")
    if before is not None:
        statement = statement.where(Report.claimed_at < before)
    found = records.scalars(
        statement.values(status="queued", attempts=Report.attempts - 1).returning(Report.id)
    )
    return len(found.all())


def claim_next(records: orm.Session) -> Report | None:
    """Take the report that waits longest; None where none waits."""
    row = records.scalar(
        sa.select(Report)
        .where(Report.status == "queued")
        .order_by(Report.id)
        .limit(1)
        .with_for_update(skip_locked=True)
    )
    if row is None:
        return None
    row.status, row.claimed_at = "running", datetime.now(UTC)
    row.attempts += 1
    records.flush()
    return row


def put_back(records: orm.Session, report_id: str, *, counts: bool = False) -> None:
    """Let a claimed report wait again; with `counts` the attempt stays counted."""
    records.execute(
        sa.update(Report)
        .where(Report.id == report_id, Report.status == "running")
        .values(status="queued", attempts=Report.attempts - (0 if counts else 1))
    )


def manifest_of(
    *,
    report_id: str,
    kind: str,
    session_id: str,
    made_at: datetime,
    core_version: str,
    forms: Mapping[str, bytes],
) -> dict[str, Any]:
    """Return what is signed of a report: what it is, and the SHA-256 of each form."""
    return {
        "report_id": report_id,
        "kind": kind,
        "session_id": session_id,
        "made_at": made_at.isoformat(timespec="seconds"),
        "core_version": core_version,
        "forms": {name: hashlib.sha256(content).hexdigest() for name, content in sorted(forms.items())},
    }


def save_report(
    records: orm.Session,
    report_id: str,
    *,
    forms: Mapping[str, bytes],
    signature: Mapping[str, Any],
    core_version: str,
    inputs_sha256: str,
    finished_at: datetime,
) -> None:
    """Store what was made, in the caller's transaction: once, and for good."""
    row = records.get_one(Report, report_id)
    for form, content in forms.items():
        records.add(
            ReportForm(
                report_id=report_id,
                form=form,
                sha256=hashlib.sha256(content).hexdigest(),
                bytes=len(content),
                content=zlib.compress(content, 6),
            )
        )
    row.signature = dict(signature)
    row.core_version, row.inputs_sha256 = core_version, inputs_sha256
    row.finished_at, row.status = finished_at, "succeeded"
    records.flush()
    about = {"report_id": report_id, "kind": row.kind, "title": row.title}
    note(records, "report.ready", {**about, **of_session(records, row.session_id)})


def save_failure(records: orm.Session, report_id: str, code: str, detail: str, advice: str | None) -> None:
    """Store why a report cannot be made."""
    failed = records.execute(
        sa.update(Report)
        .where(Report.id == report_id, Report.status == "running")
        .values(
            status="failed",
            failure={"code": code, "detail": detail, "advice": advice},
            finished_at=datetime.now(UTC),
        )
        .returning(Report.session_id, Report.kind)
    ).one_or_none()
    if failed is not None:
        about = {"report_id": report_id, "kind": failed.kind, "code": code, "detail": detail}
        note(records, "report.failed", {**about, **of_session(records, failed.session_id)})


def _forms(records: orm.Session, report_ids: Sequence[str]) -> dict[str, tuple[FormSummary, ...]]:
    found: dict[str, tuple[FormSummary, ...]] = {}
    for report_id, form, sha256, size in records.execute(
        sa.select(ReportForm.report_id, ReportForm.form, ReportForm.sha256, ReportForm.bytes)
        .where(ReportForm.report_id.in_(report_ids))
        .order_by(ReportForm.report_id, ReportForm.form)
    ):
        found[report_id] = (*found.get(report_id, ()), FormSummary(form, sha256, size))
    return found
