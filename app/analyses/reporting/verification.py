"""A stored report compared with what its inputs give today: every figure, every original, every form.

Three things are asked. Are the stored forms the ones that were signed? Do the originals, measured anew, give the grid
points that the report names? Do these, with all else as the report states it, give the report's figures? What was
changed in the session since is named, and enters none of the three.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from app.analyses.inputs.snapshot_reader import read_snapshot
from app.analyses.reporting.changes import changed_input, changed_inputs
from app.analyses.reporting.figure_uncertainty import standard_uncertainty
from app.analyses.reporting.images import measure_anew
from app.analyses.reporting.inputs import read_inputs
from app.analyses.reporting.known_fields import known_fields
from app.analyses.reporting.making import compute_analyses
from app.analyses.reporting.orders import VerificationOrder
from app.analyses.reporting.recomputation import load_reported
from app.build import core_version
from app.errors import NotFound, RowUnreadable
from app.records.database import Database
from app.records.tables import Measurement, Report, ReportForm, Session
from app.reports.forms import SENTENCES, figures_of
from app.services.reports import inflated, require_made

Json = dict[str, Any]
REPORT, REPORT_AND_SESSION, NOTHING = "report", "report_and_session", "nothing"
"""What figures are computed from: all that the report states; what an earlier version's report does not state as it is
in the session now; or nothing, since grid points are not stored any more.
"""
MIN_DIGITS = 6
"""Significant digits that figures must have in common to agree where another build computed them."""
MAX_ABSOLUTE = 1e-9
"""Figures that differ by no more than this, in their units, agree: what is zero has no significant digits."""
_SHOWN = 100
_OF_THE_RUN = ("core_version", "inputs_sha256", "pending")
"""Fields of an analysis that say when and by what it was computed, not what was found."""


def verify_report(database: Database, order: VerificationOrder) -> Json:
    """Return what the comparison found.

    Raises NotFound, Conflict where the report is not made, RowUnreadable where its document is damaged.
    """
    with database.read() as records:
        report = records.get(Report, order.report_id)
        if report is None:
            raise NotFound.of("report")
        require_made(report)
        session_id = report.session_id
        assert report.signature is not None, "a report that is made is signed"
        signed = report.signature["manifest"]["forms"]
        forms = {
            row.form: inflated(row)
            for row in records.scalars(
                sa.select(ReportForm)
                .where(ReportForm.report_id == order.report_id)
                .options(sa.orm.undefer(ReportForm.content))
            )
        }
        exists = records.get(Session, session_id) is not None
    damaged = sorted(name for name, sha256 in signed.items() if _hash(forms.get(name)) != sha256)
    text = forms.get("json")
    if text is None or "json" in damaged:
        raise RowUnreadable(f"report ({order.report_id})", ["content of json"])
    then = json.loads(text)
    found = _recomputed(database, then, order) if exists else _of_deleted_session(session_id)
    differences = found.differences
    numbers = [one["relative_difference"] for one in differences if one["relative_difference"] is not None]
    largest = max(numbers, default=0.0) if found.is_recomputed else None
    ratios = [one["in_uncertainties"] for one in differences if one["in_uncertainties"] is not None]
    disagreeing = sorted((one for one in differences if not one.pop("agrees")), key=_severity, reverse=True)
    return {
        "report_id": order.report_id,
        "agrees": found.is_recomputed
        and not (disagreeing or damaged or found.lost_originals or found.originals["differing"]),
        "is_current": not found.changed,
        "recomputed_from": found.recomputed_from,
        "current_values": found.current_values,
        "unavailable_inputs": found.unavailable[:_SHOWN],
        "unavailable_input_count": len(found.unavailable),
        "figures": found.compared,
        "figures_equal": found.compared - len(differences),
        "largest_relative_difference": largest,
        "largest_difference_in_uncertainties": max(ratios, default=0.0) if found.is_recomputed else None,
        "digits": _digits(largest),
        "differences": [*disagreeing, *(one for one in differences if one not in disagreeing)][:_SHOWN],
        "changed_inputs": found.changed[:_SHOWN],
        "changed_input_count": len(found.changed),
        "damaged_forms": damaged,
        "originals": found.originals,
        "core_version_then": then["core_version"],
        "core_version_now": core_version(),
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class _Recomputation:
    """What comes of a report's inputs. `changed` holds the lost originals, too."""

    recomputed_from: str
    unavailable: list[Json]
    changed: list[Json]
    originals: Json
    current_values: Sequence[str] = ()
    lost_originals: int = 0
    compared: int = 0
    differences: Sequence[Json] = ()

    @property
    def is_recomputed(self) -> bool:
        return self.recomputed_from != NOTHING


def _of_deleted_session(session_id: str) -> _Recomputation:
    deleted = [changed_input("session", session_id, "deleted")]
    return _Recomputation(
        recomputed_from=NOTHING, unavailable=deleted, changed=deleted, originals=_no_originals()
    )


def _recomputed(database: Database, then: Json, order: VerificationOrder) -> _Recomputation:
    """Compute a report's figures from what it states and what is stored, and its originals where they are asked for."""
    inputs, source = then["inputs"], then["source"]
    session_id = inputs["session"]["id"]
    with database.read() as records:
        snapshot = read_snapshot(records, session_id, source)
        now = read_inputs(records, snapshot, with_rms=then["kind"] == "session")
        columns = sa.select(Measurement.id, Measurement.status).where(Measurement.session_id == session_id)
        statuses = {row.id: row.status for row in records.execute(columns)}
        reported = load_reported(records, then, now)
    changed = list(changed_inputs(inputs, now, statuses))
    originals, lost = measure_anew(database, inputs, order) if order.with_originals else (_no_originals(), [])
    changed += [changed_input("image", name, change) for name, change in lost]
    differences: list[Json] = []
    compared = 0
    if reported.loaded is not None:
        analyses, refusals = compute_analyses(reported.loaded, then["kind"], source)
        is_same_build = then["core_version"] == core_version()
        if not is_same_build:
            analyses = known_fields(analyses, then["analyses"])
        before = _figures(then["analyses"], then["refusals"], with_sentences=is_same_build)
        compared = len(before)
        differences = list(_differences(before, _figures(analyses, refusals, with_sentences=is_same_build)))
    return _Recomputation(
        recomputed_from=NOTHING
        if reported.loaded is None
        else REPORT_AND_SESSION
        if reported.current_values
        else REPORT,
        unavailable=reported.unavailable,
        changed=changed,
        originals=originals,
        current_values=reported.current_values,
        lost_originals=len(lost),
        compared=compared,
        differences=differences,
    )


def _hash(content: bytes | None) -> str | None:
    return None if content is None else hashlib.sha256(content).hexdigest()


def _no_originals() -> Json:
    return {"measured": 0, "identical": 0, "largest_point_difference_px": None, "differing": []}


def _figures(
    analyses: Mapping[str, Any], refusals: Mapping[str, Any], *, with_sentences: bool
) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, document in analyses.items():
        kept = {key: value for key, value in document.items() if key not in _OF_THE_RUN}
        found |= figures_of(kept, name)
    if not with_sentences:
        found = {name: value for name, value in found.items() if name.rpartition(".")[2] not in SENTENCES}
    for name, refusal in refusals.items():
        found[f"{name}.code"] = refusal["code"]
    return found


def _differences(then: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[Json]:
    """Yield each figure that is not the same today, those that came or went too."""
    for name in (*then, *(name for name in now if name not in then)):
        before, after = then.get(name), now.get(name)
        if before == after and name in now and name in then:
            continue
        relative = _relative_difference(before, after)
        near = relative is not None and (
            relative <= 10.0**-MIN_DIGITS or abs(float(before) - float(after)) <= MAX_ABSOLUTE  # type: ignore[arg-type]
        )
        yield {
            "path": name,
            "then": _shown(before),
            "now": _shown(after),
            "relative_difference": relative,
            "in_uncertainties": _in_uncertainties(before, after, standard_uncertainty(then, name)),
            "agrees": near,
        }


def _relative_difference(before: Any, after: Any) -> float | None:
    """Return the difference by the larger of two numbers; None for what is no number."""
    for value in (before, after):
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
    size = max(abs(before), abs(after))
    return abs(before - after) / size if size > 0.0 else 0.0


def _in_uncertainties(before: Any, after: Any, uncertainty: float | None) -> float | None:
    """Return the difference of two numbers over their standard uncertainty; None where there is no such."""
    if uncertainty is None or _relative_difference(before, after) is None:
        return None
    return float(abs(before - after) / uncertainty)


def _severity(difference: Json) -> float:
    """Return how much a difference matters: by its figure's uncertainty, else relative to the figure; texts most."""
    if difference["relative_difference"] is None:
        return math.inf
    ratio = difference["in_uncertainties"]
    return float(difference["relative_difference"] if ratio is None else ratio)


def _digits(largest: float | None) -> int | None:
    """Return how many significant digits all figures have in common at least; None where all are equal or unknown."""
    return None if not largest else max(0, math.floor(-math.log10(largest)))


def _shown(value: Any) -> str | None:
    return None if value is None else str(value)[:200]
