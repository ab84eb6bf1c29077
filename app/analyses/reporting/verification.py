"""A stored report compared with what its inputs give today: every figure, every original, every input.

Three things are asked. Are the stored forms the ones that were signed? Are the inputs the ones that the report names,
and do the originals, measured anew, give the stored grid points? Do the stored grid points give the report's figures?
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import sqlalchemy as sa

from app.analyses.reporting.images import measure_anew
from app.analyses.reporting.known_fields import known_fields
from app.analyses.reporting.making import compute_analyses, read_moment
from app.analyses.reporting.orders import VerificationOrder
from app.build import core_version
from app.errors import NotFound, RowUnreadable
from app.records.database import Database
from app.records.tables import Report, ReportForm, Session
from app.reports.forms import SENTENCES, figures_of
from app.services.reports import inflated, require_made

Json = dict[str, Any]
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
    changed: list[Json] = []
    originals, differences, compared = _no_originals(), [], 0
    if not exists:
        changed = [_change("session", session_id, "deleted")]
    else:
        loaded, now = read_moment(database, session_id, then["source"], with_rms=then["kind"] == "session")
        changed = list(_changed_inputs(then["inputs"], now))
        if order.with_originals:
            originals, lost = measure_anew(database, then["inputs"]["images"], order)
            changed += [_change("image", name, change) for name, change in lost]
        analyses, refusals = compute_analyses(loaded, then["kind"], then["source"])
        is_same_build = then["core_version"] == core_version()
        if not is_same_build:
            analyses = known_fields(analyses, then["analyses"])
        before = _figures(then["analyses"], then["refusals"], with_sentences=is_same_build)
        compared = len(before)
        differences = list(_differences(before, _figures(analyses, refusals, with_sentences=is_same_build)))
    numbers = [one["relative_difference"] for one in differences if one["relative_difference"] is not None]
    largest = max(numbers, default=0.0) if exists else None
    disagreeing = [one for one in differences if not one.pop("agrees")]
    return {
        "report_id": order.report_id,
        "agrees": exists and not disagreeing and not changed and not damaged and not originals["differing"],
        "figures": compared,
        "figures_equal": compared - len(differences),
        "largest_relative_difference": largest,
        "digits": _digits(largest),
        "differences": [*disagreeing, *(one for one in differences if one not in disagreeing)][:_SHOWN],
        "changed_inputs": changed[:_SHOWN],
        "changed_input_count": len(changed),
        "damaged_forms": damaged,
        "originals": originals,
        "core_version_then": then["core_version"],
        "core_version_now": core_version(),
    }


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
            "figure": name,
            "then": _shown(before),
            "now": _shown(after),
            "relative_difference": relative,
            "agrees": near,
        }


def _relative_difference(before: Any, after: Any) -> float | None:
    """Return the difference by the larger of two numbers; None for what is no number."""
    for value in (before, after):
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
    size = max(abs(before), abs(after))
    return abs(before - after) / size if size > 0.0 else 0.0


def _digits(largest: float | None) -> int | None:
    """Return how many significant digits all figures have in common at least; None where all are equal or unknown."""
    return None if not largest else max(0, math.floor(-math.log10(largest)))


def _shown(value: Any) -> str | None:
    return None if value is None else str(value)[:200]


def _changed_inputs(then: Json, now: Json) -> Iterator[Json]:
    """Yield what the report was made from and is not the same today."""
    for noun in ("session", "robot"):
        before, after = then[noun], now[noun]
        if before == after:
            continue
        name = str((before or after)["id"])
        if before is None or after is None or before["id"] != after["id"]:
            yield _change(noun, name, "replaced")
        else:
            yield _change(noun, name, f"changed: {', '.join(_fields(before, after))}")
    for noun, plural, key in (
        ("target", "targets", "id"),
        ("pose", "poses", "pose_id"),
        ("image", "images", "measurement_id"),
        ("measured_pose", "measured_poses", "measurement_id"),
    ):
        yield from _changed_list(noun, then[plural], now[plural], key)


def _changed_list(noun: str, then: Sequence[Json], now: Sequence[Json], key: str) -> Iterator[Json]:
    present = {one[key]: one for one in now}
    for before in then:
        after = present.pop(before[key], None)
        if after is None:
            yield _change(noun, before[key], "deleted")
        elif changed := _fields(before, after):
            yield _change(noun, before[key], f"changed: {', '.join(changed)}")
    for name in present:
        yield _change(noun, name, "added")


def _fields(before: Json, after: Json) -> list[str]:
    return sorted(name for name in {*before, *after} if before.get(name) != after.get(name))


def _change(noun: str, name: str, change: str) -> Json:
    return {"noun": noun, "name": name, "change": change}
