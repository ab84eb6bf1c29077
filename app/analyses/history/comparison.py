"""Two reports compared: each figure of the later with the earlier's, with intervals, and a conclusion in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from scipy.special import bdtrc, ndtr

from app.analyses.history.likeness import not_stated, unlike
from app.analyses.history.summaries import DISTANCES, TURNED_DISTANCE, Key, Summary
from app.records.numbers import rounded
from core.metrology import Difference, estimate_difference

_LEVEL = 0.95
_MAX_CHANCE = 0.05


def comparison_document(first: Summary, second: Summary) -> dict[str, Any]:
    """Return the comparison of two reports, the later by the time of measurement with the earlier.

    Figures without an interval (noise floors) are not compared: they are what the instrument adds.
    """
    earlier, later = sorted((first, second), key=lambda one: (one.measured_at, one.report_id))
    differences: dict[Key, Difference] = {}
    rows = []
    for key, before in earlier.figures.items():
        after = later.figures.get(key)
        if after is None or before.interval is None or after.interval is None:
            continue
        found = estimate_difference(before.value, before.interval, after.value, after.interval)
        differences[key] = found
        has_ratio = before.is_length and found.ratio is not None and found.ratio_interval is not None
        rows.append(
            {
                "of": key[0],
                "figure": key[1],
                "unit": before.unit,
                "earlier_value": before.value,
                "later_value": after.value,
                "difference": found.difference,
                "difference_interval": list(found.interval),
                "ratio": found.ratio if has_ratio else None,
                "ratio_interval": list(found.ratio_interval) if has_ratio and found.ratio_interval else None,
                "change": found.change,
            }
        )
    reasons = unlike(earlier, later)
    return {
        "earlier": _subject(earlier),
        "later": _subject(later),
        "comparable": not reasons,
        "reasons": reasons,
        "not_stated": not_stated(earlier, later),
        "change_shown": shows_change(differences),
        "conclusion": conclusion(differences, reasons),
        "compared": len(rows),
        "changed": sum(one["change"] != "no_change_shown" for one in rows),
        "expected_by_chance": round((1.0 - _LEVEL) * len(rows), 2),
        "compared_figures": rounded(rows),
    }


def shows_change(differences: Mapping[Key, Difference]) -> bool:
    """Return whether figures differ by more than chance gives."""
    changed = any(one.change != "no_change_shown" for one in differences.values())
    return changed and _chance(differences) <= _MAX_CHANCE


def conclusion(differences: Mapping[Key, Difference], reasons: Sequence[str]) -> str:
    """Return what two sessions show, in words; of many figures, some differ by chance."""
    unlike_words = f"The sessions are not comparable ({'; '.join(reasons)})"
    if not differences:
        return f"Nothing can be compared. {unlike_words}." if reasons else "Nothing can be compared."
    changed = {key: one for key, one in differences.items() if one.change != "no_change_shown"}
    count, total = len(changed), len(differences)
    expected = (1.0 - _LEVEL) * total
    largest = max(one.deviation for one in differences.values())
    if not changed:
        each = f"each of {total} figures" if total > 1 else "the one figure"
        found = f"No change is shown: the 95 % interval of {each} includes no change."
    elif not shows_change(differences):
        found = (
            f"{count} of {total} figures differ, as many as chance gives ({expected:.1f} expected): "
            "no change is shown."
        )
    else:
        ways = {one.change for one in changed.values()}
        way = "are larger" if ways == {"larger"} else "are smaller" if ways == {"smaller"} else "differ"
        found = (
            f"{count} of {total} figures {way}, one by {largest:.1f} standard deviations; chance alone would give "
            f"{expected:.1f}: something changed."
        )
        if not shows_change({key: one for key, one in differences.items() if key[1] != TURNED_DISTANCE}):
            found += (
                " Only distances between poses of different orientation show it, which change as well where the camera "
                "or the reflector was mounted anew."
            )
    return f"{found} {unlike_words}, so that a change need not be the robot's." if reasons else found


def _chance(differences: Mapping[Key, Difference]) -> float:
    """Return the chance of as many changed figures, or of one as far off, where nothing changed.

    Distances share poses: one mean that is off by chance moves several of them. They count by how far they are off
    alone, which holds however figures depend on one another (Bonferroni), and so does the lesser of the two chances.
    """
    apart = [one.change != "no_change_shown" for key, one in differences.items() if key[1] not in DISTANCES]
    by_count = float(bdtrc(sum(apart) - 1, len(apart), 1.0 - _LEVEL)) if any(apart) else 1.0
    largest = max(one.deviation for one in differences.values())
    by_largest = min(len(differences) * 2.0 * float(ndtr(-largest)), 1.0)
    return 2.0 * min(by_count, by_largest)


def _subject(report: Summary) -> dict[str, Any]:
    return {
        "report_id": report.report_id,
        "kind": report.kind,
        "session_id": report.session[0],
        "session_name": report.session[1],
        "robot_id": report.robot_id,
        "measured_at": report.measured_at,
    }
