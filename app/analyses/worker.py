"""One analysis in a process of its own: it reads the session itself and returns bytes, so that neither grid points nor
estimates pass through the process that takes uploads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, TypeVar

import numpy as np

from app.analyses.documents.camera.camera_files import camera_file
from app.analyses.documents.camera.intrinsics import intrinsics_findings
from app.analyses.documents.camera_poses import camera_poses_findings
from app.analyses.documents.comparison import comparison_findings
from app.analyses.documents.dh import compensation_findings, dh_findings, error_map_findings
from app.analyses.documents.findings import Findings, findings_document
from app.analyses.documents.hand_eye import hand_eye_findings
from app.analyses.documents.joint_noise import joint_noise_findings
from app.analyses.documents.next_view import next_view_findings
from app.analyses.documents.qualification import qualification_findings
from app.analyses.documents.repeatability import repeatability_findings
from app.analyses.inputs.change_token import read_change_token
from app.analyses.inputs.session_loader import Markers, load_session, read_markers
from app.analyses.inputs.session_subject import subject_in_words
from app.analyses.inputs.snapshot import Snapshot
from app.analyses.inputs.snapshot_reader import read_snapshot
from app.analyses.outcome import AnalysisError, AnalysisRefused, AnalysisResult
from app.build import core_version
from app.records.database import Database
from app.records.numbers import encode
from core import Advisory, GridposeError
from core.jit import few_collections
from core.session import SessionData

Found = TypeVar("Found")
Document = Callable[[SessionData, Mapping[str, str]], Findings | bytes]
Plot = Callable[[SessionData, Mapping[str, str], str], bytes]
"""Draws with what is drawn in words: session, robot and date."""


def _cycle_points(data: SessionData, settings: Mapping[str, str]) -> bytes:
    from app.analyses.documents import plots

    return plots.cycle_points(data, settings)


def _plot(name: str) -> Plot:
    """Return what draws a plot; matplotlib is loaded when the first is asked for, not for every analysis."""

    def draw(data: SessionData, settings: Mapping[str, str], about: str) -> bytes:
        from app.analyses.documents import plots

        svg: bytes = getattr(plots, name)(data, settings, about)
        return svg

    return draw


ANALYSES: dict[str, Document] = {
    "intrinsics": intrinsics_findings,
    "camera_file": camera_file,
    "repeatability": repeatability_findings,
    "camera_poses": camera_poses_findings,
    "hand_eye": hand_eye_findings,
    "dh": dh_findings,
    "kinematic_error": error_map_findings,
    "joint_noise": joint_noise_findings,
    "next_view": next_view_findings,
    "qualification": qualification_findings,
    "cycle_points": _cycle_points,
}
PLOTS: dict[str, Plot] = {
    name: _plot(name)
    for name in (
        *("scatter_plot", "drift_plot", "steadiness_plot", "residual_map", "projection_map"),
        *("joint_curves_plot", "lens_profile_plot", "joint_noise_map", "error_map", "identifiability_plot"),
    )
}


@dataclass(frozen=True, slots=True)
class LoadedSession:
    """One session at one moment: what every analysis of it is computed from."""

    snapshot: Snapshot
    data: SessionData
    markers: Markers
    second: SessionData | None
    change_token: str


def analyse(
    database: Database, analysis: str, session_id: str, settings: Mapping[str, str]
) -> AnalysisResult:
    """Compute one document from what the session holds now, or determine why it cannot be computed."""
    source = settings.get("source", "images")
    with few_collections():  # rows, images and poses, some ten objects an image, stay to the end
        loaded = load(
            database,
            session_id,
            source,
            with_markers=analysis == "comparison",
            second_id=settings.get("confirming_session_id"),
        )
        inputs_sha256 = loaded.snapshot.inputs_sha256(analysis, settings)
        return AnalysisResult(
            loaded.snapshot.answer_sha256(inputs_sha256),
            document_of(loaded, analysis, settings, inputs_sha256=inputs_sha256),
            loaded.change_token,
        )


def load(
    database: Database,
    session_id: str,
    source: str,
    *,
    with_markers: bool = False,
    second_id: str | None = None,
) -> LoadedSession:
    """Read a session, and a second one to confirm it, in one transaction. Raises NotFound, RowUnreadable."""
    second: SessionData | None = None
    with database.read() as records:
        change_token = read_change_token(records, session_id)
        snapshot = read_snapshot(records, session_id, source)
        data = load_session(records, snapshot, source)
        markers = read_markers(records, session_id) if with_markers else {}
        if second_id:
            second = load_session(records, read_snapshot(records, second_id, source), source)
    return LoadedSession(snapshot, data, markers, second, change_token)


def document_of(
    loaded: LoadedSession,
    analysis: str,
    settings: Mapping[str, str],
    *,
    as_text: Callable[[Mapping[str, Any]], bytes] = encode,
    inputs_sha256: str | None = None,
) -> bytes | AnalysisRefused:
    """Compute one document of a loaded session, or determine why it cannot be computed; `inputs_sha256` where it is
    known.
    """
    snapshot, data = loaded.snapshot, loaded.data
    head: dict[str, Any] = {  # of documents; a drawing has names and dates, but neither ids nor hashes
        "session_id": snapshot.session_id,
        "subject": snapshot.subject,
        "inputs_sha256": inputs_sha256 or snapshot.inputs_sha256(analysis, settings),
        "core_version": core_version(),
        "pending": snapshot.pending,
    }

    def find() -> Findings | bytes:
        if analysis == "comparison":
            return comparison_findings(data, loaded.markers)
        if analysis == "compensation":
            return compensation_findings(data, loaded.second, settings)
        if analysis in PLOTS:
            return PLOTS[analysis](data, settings, subject_in_words(snapshot.subject))
        return ANALYSES[analysis](data, settings)

    found = _found_or_refused(find)
    if isinstance(found, bytes | AnalysisRefused):
        return found
    found = replace(found, warnings=[*found.warnings, *_of_stated_targets(snapshot)])
    return as_text(findings_document(head, found, data))


def _of_stated_targets(snapshot: Snapshot) -> list[Advisory]:
    """Return a warning where images count as of another target than they were sent as."""
    count = sum(image.stated_target_id is not None and bool(image.point_bytes) for image in snapshot.images)
    if not count:
        return []
    return [
        Advisory(
            "stated_target_removed",
            f"{count} measurements are of another target than their images were sent with, "
            "which was taken out of it.",
            "Add that target to the session's target_ids again. Exclude these measurements if they are not to count.",
        )
    ]


def pages_of(
    loaded: LoadedSession, plot: str, settings: Mapping[str, str], poses_a_page: int | None
) -> list[bytes] | AnalysisRefused:
    """Draw a loaded session on pages that show so many poses at most, a plot without poses on one."""
    if poses_a_page is None:
        drawn = document_of(loaded, plot, settings)
        return [drawn] if isinstance(drawn, bytes) else drawn
    from app.analyses.documents import plots

    about = subject_in_words(loaded.snapshot.subject)
    return _found_or_refused(lambda: getattr(plots, plot)(loaded.data, settings, about, poses_a_page))


def _found_or_refused(find: Callable[[], Found]) -> Found | AnalysisRefused:
    try:
        return find()
    except AnalysisError as reason:
        return reason.refused
    except GridposeError as error:
        return AnalysisRefused(error.code, error.detail, error.advice)
    except np.linalg.LinAlgError:
        return AnalysisRefused(
            "degenerate_geometry",
            "The measurements are so nearly equal, or so uncertain, that the equations have no solution.",
            "Add measurements that differ more, and check the units of what was stated.",
        )


@cache
def open_database(url: str) -> Database:
    """Return this process's own connections; they are kept from one call to the next."""
    return Database(url)
