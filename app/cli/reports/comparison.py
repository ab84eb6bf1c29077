"""`gridpose report compare`: what changed between two sessions, with intervals, in plain words."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from scipy.special import bdtrc

from app.cli.console import error_console, print_list
from app.cli.options.access import ReadAccess
from app.cli.reports.figures import FiledReport, not_stated, read_filed, unlike
from app.client import ServiceClient
from core.metrology import Difference, estimate_difference

_LEVEL = 0.95
_MAX_CHANCE = 0.05
_NOT_ESTIMATED = "noise floor"
"""A figure that has no interval: it is what the instrument adds, and is listed by `robots history` alone."""
Subject = Annotated[str, typer.Argument(metavar="REPORT|FILE", help="A report's id, or its JSON form.")]


def compare(first: Subject, second: Subject, service: ReadAccess) -> int:
    """Compare the figures of two reports, the later with the earlier, with intervals and a verdict in words.

    Files need no service. Ends with 1 where the sessions are not comparable: a difference need not be the robot's then.
    """
    code: list[int] = []

    def act(client: ServiceClient | None) -> None:
        code.append(_compare(_read(client, first), _read(client, second)))

    if Path(first).is_file() and Path(second).is_file():
        act(None)
        return code[0]
    ended = service.run(act)
    return ended or code[0]


def _read(client: ServiceClient | None, name: str) -> FiledReport:
    if client is None or Path(name).is_file():
        return read_filed(Path(name).read_bytes(), name)
    return read_filed(client.get_bytes(f"/v1/reports/{name}.json"), name)


def _compare(first: FiledReport, second: FiledReport) -> int:
    if second.measured_at < first.measured_at:
        first, second = second, first
    differences = {
        key: estimate_difference(
            figure.value, figure.interval, second.figures[key].value, second.figures[key].interval
        )
        for key, figure in first.figures.items()
        if key in second.figures and key[1] != _NOT_ESTIMATED
    }
    print(f"earlier  {first.session[1]}, {first.measured_at}, report {first.report_id}")
    print(f"later    {second.session[1]}, {second.measured_at}, report {second.report_id}")
    print_list(
        ("of", "figure", "earlier", "later", "change", "95 % interval", ""),
        [
            (*key, *_cells(first, second, key, difference), _WORDS[difference.change])
            for key, difference in differences.items()
        ],
        "The two reports have no figure in common.",
    )
    reasons = unlike(first, second)
    print(verdict(differences, reasons))
    unknown = not_stated(first, second)
    if unknown:
        error_console().print(
            escape(
                f"Whether {' and '.join(unknown)} were the same is not known: state it with the sessions."
            ),
            style="yellow",
        )
    return int(bool(reasons))


_WORDS = {"larger": "larger", "smaller": "smaller", "no_change_shown": ""}


def verdict(differences: dict[tuple[str, str], Difference], reasons: list[str]) -> str:
    """Return what two sessions show, in words; of many figures, some differ by chance."""
    if not differences:
        return "Nothing can be compared."
    changed = {key: one for key, one in differences.items() if one.change != "no_change_shown"}
    count, total = len(changed), len(differences)
    expected = (1.0 - _LEVEL) * total
    chance = float(bdtrc(count - 1, total, 1.0 - _LEVEL)) if count else 1.0
    if not changed:
        found = f"No change is shown: all {total} intervals contain none."
    elif chance > _MAX_CHANCE:
        found = (
            f"{count} of {total} figures differ, as many as chance gives ({expected:.1f} expected): "
            "no change is shown."
        )
    else:
        ways = {one.change for one in changed.values()}
        way = "are larger" if ways == {"larger"} else "are smaller" if ways == {"smaller"} else "differ"
        found = (
            f"{count} of {total} figures {way}; chance alone would give {expected:.1f}: something changed."
        )
    if reasons:
        found += f" The sessions are not comparable ({'; '.join(reasons)}), so that a change need not be the robot's."
    return found


def _cells(
    first: FiledReport, second: FiledReport, key: tuple[str, str], one: Difference
) -> tuple[str, str, str, str]:
    unit = first.figures[key].unit
    values = (f"{first.figures[key].value:.6g} {unit}", f"{second.figures[key].value:.6g} {unit}")
    if one.ratio is not None and one.ratio_interval is not None and first.figures[key].is_length:
        low, high = one.ratio_interval
        return (*values, f"× {one.ratio:.3g}", f"× {low:.3g} to {high:.3g}")
    low, high = one.interval
    return (*values, f"{one.difference:+.3g} {unit}", f"{low:+.3g} to {high:+.3g} {unit}")
