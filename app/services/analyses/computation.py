"""One analysis in the process beside the head: it reads the session itself and returns bytes, so that neither grid
points nor estimates pass through the process that takes uploads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from app.records.database import Database
from app.services.analyses.comparison import comparison_document
from app.services.analyses.documents import encode
from app.services.analyses.intrinsics import intrinsics_document
from app.services.analyses.kinematics import dh_document
from app.services.analyses.naming import name_alike
from app.services.analyses.outcome import Analysed, CannotAnalyse, Refused
from app.services.analyses.repeatability import repeatability_document
from app.services.analyses.revision import read_mark
from app.services.analyses.snapshot import Snapshot, read_markers, read_points, read_readings, read_snapshot
from app.settings import program_version
from core import GridposeError

Document = Callable[[Snapshot, Mapping[str, bytes], Mapping[str, str]], dict[str, Any] | bytes]


def _plot(name: str) -> Document:
    """Return what draws a plot; matplotlib is loaded when the first is asked for, not for every analysis."""

    def draw(snapshot: Snapshot, points: Mapping[str, bytes], settings: Mapping[str, str]) -> bytes:
        from app.services.analyses import plots

        svg: bytes = getattr(plots, name)(snapshot, points, settings)
        return svg

    return draw


ANALYSES: dict[str, Document] = {
    "intrinsics": intrinsics_document,
    "repeatability": repeatability_document,
    "comparison": comparison_document,
    "dh": dh_document,
    "scatter_plot": _plot("scatter_plot"),
    "drift_plot": _plot("drift_plot"),
    "residual_map": _plot("residual_map"),
}


def analyse(
    database: Database, analysis: str, session_id: str, settings: Mapping[str, str]
) -> Analysed | Refused:
    """Compute one document from what the session holds now."""
    source = settings.get("source", "images")
    points: dict[str, bytes] = {}
    with database.read() as records:
        mark = read_mark(records, session_id)
        snapshot = read_snapshot(records, session_id, source)
        if source == "measured_poses":
            snapshot = replace(snapshot, readings=read_readings(records, session_id))
        else:
            points = read_points(records, session_id)
        if analysis == "comparison":
            snapshot = replace(snapshot, markers=read_markers(records, session_id))
    inputs_sha256 = snapshot.inputs_sha256(analysis, settings)
    snapshot, points = name_alike(snapshot, points)
    try:
        document = ANALYSES[analysis](snapshot, points, settings)
    except CannotAnalyse as reason:
        return reason.refused
    except GridposeError as error:
        return Refused(error.code, error.detail, error.advice)
    except np.linalg.LinAlgError:
        return Refused(
            "degenerate_geometry",
            "The measurements are so nearly alike, or so uncertain, that the equations have no answer.",
            "Add measurements that differ more, and check the units of what was stated.",
        )
    if isinstance(document, bytes):  # a picture holds neither ids nor hashes
        return Analysed(inputs_sha256, snapshot.pending, document, mark)
    head = {
        "session_id": session_id,
        "inputs_sha256": inputs_sha256,
        "core_version": program_version(),
        "pending": snapshot.pending,
    }
    return Analysed(inputs_sha256, snapshot.pending, encode({**head, **document}), mark)


@cache
def open_database(url: str) -> Database:
    """Return this process's own connections; they are kept from one call to the next."""
    return Database(url)
