"""`gridpose report compare`: what changed between two sessions, with intervals, in plain words."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from app.analyses.history import NotAReport, Summary, comparison_document, read_report
from app.cli.options.access import ReadAccess
from app.client import Json
from app.client.commands import OptionRefused, error_console, print_error, print_list

Subject = Annotated[str, typer.Argument(metavar="REPORT|FILE", help="A report's id, or its JSON form.")]
_WORDS = {"larger": "larger", "smaller": "smaller", "no_change_shown": ""}


def compare(first: Subject, second: Subject, service: ReadAccess) -> int:
    """Compare the figures of two reports, the later with the earlier, with intervals and a conclusion in words.

    Files need no service. Ends with 1 where the sessions are not comparable: a difference need not be the robot's then.
    """
    files = [Path(name).is_file() for name in (first, second)]
    if all(files):
        try:
            return _show(comparison_document(read_file(first), read_file(second)))
        except OptionRefused as refused:
            print_error(error_console(), str(refused), refused.advice)
            return 2
    with service.connect() as client:
        if any(files):
            read = [
                read_file(name)
                if is_file
                else read_content(client.get_bytes(f"/v1/reports/{name}.json"), name)
                for name, is_file in zip((first, second), files, strict=True)
            ]
            found = comparison_document(*read)
        else:
            found = client.get(f"/v1/reports/{first}/comparison/{second}")
    return _show(found)


def read_file(name: str) -> Summary:
    """Return what is compared of a saved JSON form. Raises OptionRefused for anything else."""
    return read_content(Path(name).read_bytes(), name)


def read_content(content: bytes, name: str) -> Summary:
    """Return what is compared of a JSON form's bytes. Raises OptionRefused for anything else."""
    try:
        return read_report(content)
    except NotAReport as error:
        if error.is_later:
            raise OptionRefused(
                f"{name} is a report of a later version.", "Update gridpose on this machine."
            ) from error
        raise OptionRefused(
            f"{name} is not the JSON form of a report.",
            "Name a report's id, or a file that `gridpose report fetch --form json` saved.",
        ) from error


def _show(found: Json) -> int:
    for which in ("earlier", "later"):
        one = found[which]
        print(f"{which:<8} {one['session_name']}, {one['measured_at']}, report {one['report_id']}")
    print_list(
        ("of", "figure", "earlier", "later", "change", "95 % interval", ""),
        [
            (one["of"], one["figure"], *_cells(one), _WORDS[one["change"]])
            for one in found["compared_figures"]
        ],
        "The two reports have no figure in common.",
    )
    print(found["conclusion"])
    if found["not_stated"]:
        error_console().print(
            escape(
                f"Whether {' and '.join(found['not_stated'])} were the same is not known: state it with the sessions."
            ),
            style="yellow",
        )
    return int(not found["comparable"])


def _cells(one: Json) -> tuple[str, str, str, str]:
    unit = one["unit"]
    values = (f"{one['earlier_value']:.6g} {unit}", f"{one['later_value']:.6g} {unit}")
    if one["ratio"] is not None:
        low, high = one["ratio_interval"]
        return (*values, f"× {one['ratio']:.3g}", f"× {low:.3g} to {high:.3g}")
    low, high = one["difference_interval"]
    return (*values, f"{one['difference']:+.3g} {unit}", f"{low:+.3g} to {high:+.3g} {unit}")
