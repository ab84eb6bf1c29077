"""A report from what a session holds at one moment: its analyses, their drawings, its inputs, and every form."""

from __future__ import annotations

import json
from typing import Any

from app.analyses.documents.robot_files import exports_of
from app.analyses.inputs.change_token import read_change_token
from app.analyses.outcome import AnalysisRefused
from app.analyses.reporting.inputs import inputs_hash, read_inputs
from app.analyses.reporting.orders import DRAWINGS, KINDS, MadeReport, ReportOrder, settings_of
from app.analyses.worker import LoadedSession, document_of, load, pages_of
from app.build import core_version
from app.errors import Conflict
from app.records.database import Database
from app.records.numbers import encode_record
from app.reports.forms import FORMAT, FORMAT_VERSION, RenderingFailed, render_forms
from app.services import measured_poses

_MOMENTS = 3
"""How often a session is read anew that changed while it was read."""


def make_report(database: Database, order: ReportOrder) -> MadeReport:
    """Return a report with all of its forms.

    Raises NotFound, and Conflict where its analysis cannot be made or a form cannot be drawn.
    """
    source = source_of(database, order.session_id)
    loaded, inputs = read_moment(database, order.session_id, source, with_rms=order.kind == "session")
    analyses, refusals = compute_analyses(loaded, order.kind, source)
    if order.kind != "session" and refusals:
        (refused,) = refusals.values()
        raise Conflict(refused["detail"], refused["advice"], code=refused["code"])
    if not inputs["images"] and not inputs["measured_poses"]:
        raise Conflict(
            "The session holds no finished measurement to report on.",
            "Upload images or import measured poses first, and wait until they are measured.",
            code="too_few_measurements",
        )
    inputs_sha256 = inputs_hash(inputs)
    document = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "report_id": order.report_id,
        "kind": order.kind,
        "title": order.title,
        "signatories": order.signatories,
        "paper": order.paper,
        "made_at": order.made_at.isoformat(timespec="seconds"),
        "made_by": order.made_by,
        "signing_key": order.signing_key,
        "core_version": core_version(),
        "inputs_sha256": inputs_sha256,
        "source": source,
        "subject": loaded.snapshot.subject,
        "template": order.template.document(),
        "analyses": analyses,
        "refusals": refusals,
        "inputs": inputs,
    }
    try:
        drawings = _drawings(loaded, order.kind, source)
        forms = render_forms(document, drawings, order.template, _exports(loaded, document, source))
    except RenderingFailed as error:
        raise Conflict(
            f"The PDF of the report cannot be drawn: {error.detail}",
            error.advice,
            code="report_not_drawable",
        ) from error
    return MadeReport(forms, core_version(), inputs_sha256)


def _exports(loaded: LoadedSession, document: dict[str, Any], source: str) -> dict[str, str]:
    """Return the files for other programs that the PDF of a report on kinematics carries."""
    if document["kind"] != "kinematics":
        return {}
    inputs, found = document["inputs"], document["analyses"]["dh"]
    chain = None
    if found["chain_residual"] is not None:
        alone = document_of(loaded, "dh", {**settings_of("dh", source), "model": "dh"})
        chain = None if isinstance(alone, AnalysisRefused) else json.loads(alone)
    return exports_of(found, inputs["robot"], inputs["session"]["name"], chain)


def source_of(database: Database, session_id: str) -> str:
    """Return where a session's poses are from: another instrument only where there are no images at all."""
    with database.read() as records:
        return measured_poses.source_of(records, session_id)


def read_moment(
    database: Database, session_id: str, source: str, *, with_rms: bool
) -> tuple[LoadedSession, dict[str, Any]]:
    """Return a session and its inputs, both of one moment. Raises NotFound, Conflict where it keeps changing."""
    for _ in range(_MOMENTS):
        loaded = load(database, session_id, source)
        with database.read() as records:
            if read_change_token(records, session_id) == loaded.change_token:
                return loaded, read_inputs(records, loaded.snapshot, with_rms=with_rms)
    raise Conflict(
        "The session changed whenever it was read.",
        "Wait until its images are uploaded and measured, then order the report again.",
        code="session_changing",
    )


def compute_analyses(
    loaded: LoadedSession, kind: str, source: str
) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Return the documents of a kind's analyses, and for those that cannot be made code, detail and advice."""
    documents: dict[str, Any] = {}
    refusals: dict[str, dict[str, Any]] = {}
    for analysis in KINDS[kind]:
        found = document_of(loaded, analysis, settings_of(analysis, source), as_text=encode_record)
        if isinstance(found, AnalysisRefused):
            refusals[analysis] = {"code": found.code, "detail": found.detail, "advice": found.advice}
        else:
            documents[analysis] = json.loads(found)
    return documents, refusals


def _drawings(loaded: LoadedSession, kind: str, source: str) -> dict[str, list[str]]:
    """Return the pages of the drawings of a kind that can be drawn; the tables say what the others would lack."""
    found = {}
    for one in DRAWINGS[kind]:
        drawn = pages_of(loaded, one.plot, settings_of(one.plot, source), one.poses_a_page)
        if not isinstance(drawn, AnalysisRefused):
            found[one.name] = [page.decode() for page in drawn]
    return found
