"""One analysis in a process of its own: it reads the session itself and returns bytes, so that neither grid points nor
estimates pass through the process that takes uploads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from app.analyses.documents.camera_poses import camera_poses_findings
from app.analyses.documents.comparison import comparison_findings
from app.analyses.documents.dh import dh_findings
from app.analyses.documents.findings import Findings, findings_document
from app.analyses.documents.hand_eye import hand_eye_findings
from app.analyses.documents.intrinsics import intrinsics_findings
from app.analyses.documents.qualification import qualification_findings
from app.analyses.documents.repeatability import repeatability_findings
from app.analyses.inputs.change_token import read_change_token
from app.analyses.inputs.session_loader import Markers, load_session, read_markers
from app.analyses.inputs.snapshot import read_snapshot
from app.analyses.json_text import encode
from app.analyses.outcome import AnalysisError, AnalysisRefused, AnalysisResult
from app.build import core_version
from app.records.database import Database
from core import GridposeError
from core.session import SessionData

Document = Callable[[SessionData, Mapping[str, str]], Findings | bytes]


def _plot(name: str) -> Document:
    """Return what draws a plot; matplotlib is loaded when the first is asked for, not for every analysis."""

    def draw(data: SessionData, settings: Mapping[str, str]) -> bytes:
        from app.analyses.documents import plots

        svg: bytes = getattr(plots, name)(data, settings)
        return svg

    return draw


ANALYSES: dict[str, Document] = {
    "intrinsics": intrinsics_findings,
    "repeatability": repeatability_findings,
    "camera_poses": camera_poses_findings,
    "hand_eye": hand_eye_findings,
    "dh": dh_findings,
    "qualification": qualification_findings,
    "scatter_plot": _plot("scatter_plot"),
    "drift_plot": _plot("drift_plot"),
    "steadiness_plot": _plot("steadiness_plot"),
    "residual_map": _plot("residual_map"),
}


def analyse(
    database: Database, analysis: str, session_id: str, settings: Mapping[str, str]
) -> AnalysisResult:
    """Compute one document from what the session holds now, or determine why it cannot be computed."""
    source = settings.get("source", "images")
    markers: Markers = {}
    with database.read() as records:
        change_token = read_change_token(records, session_id)
        snapshot = read_snapshot(records, session_id, source)
        data = load_session(records, snapshot, source)
        if analysis == "comparison":
            markers = read_markers(records, session_id)
    inputs_sha256 = snapshot.inputs_sha256(analysis, settings)
    head: dict[str, Any] = {  # of documents; a drawing holds neither ids nor hashes
        "session_id": session_id,
        "subject": snapshot.subject,
        "inputs_sha256": inputs_sha256,
        "core_version": core_version(),
        "pending": snapshot.pending,
    }
    try:
        found: Findings | bytes
        if analysis == "comparison":
            found = comparison_findings(data, markers)
        else:
            found = ANALYSES[analysis](data, settings)
    except AnalysisError as reason:
        outcome: bytes | AnalysisRefused = reason.refused
    except GridposeError as error:
        outcome = AnalysisRefused(error.code, error.detail, error.advice)
    except np.linalg.LinAlgError:
        outcome = AnalysisRefused(
            "degenerate_geometry",
            "The measurements are so nearly equal, or so uncertain, that the equations have no solution.",
            "Add measurements that differ more, and check the units of what was stated.",
        )
    else:
        outcome = found if isinstance(found, bytes) else encode(findings_document(head, found, data))
    return AnalysisResult(snapshot.answer_sha256(analysis, settings), outcome, change_token)


@cache
def open_database(url: str) -> Database:
    """Return this process's own connections; they are kept from one call to the next."""
    return Database(url)
