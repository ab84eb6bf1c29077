"""Rows of earlier runs, read back from benchmarks/RESULTS.md: it is the only place where they are kept."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from benchmarks.table import Row

_HEAD = "| what | measured | goal | met | how |"
_RUN = re.compile(r"^(\d{4}-\d{2}-\d{2}),.*?commit ([0-9a-f]{7}\+?)", re.MULTILINE)
_VERDICTS = {"yes": True, "NO": False, "": None}


@dataclass(frozen=True, slots=True)
class Section:
    """One section's rows, and the day and commit of its run."""

    name: str
    rows: tuple[Row, ...]
    run: str


def sections_of(document: str) -> Mapping[str, Section]:
    """Return the sections that hold rows, by name."""
    found = {}
    for text in document.split("\n## ")[1:]:
        name, _, body = text.partition("\n")
        head, table, rows = body.partition(_HEAD)
        if table:
            found[name.strip()] = Section(name.strip(), tuple(map(_row, _cells(rows))), _run(head))
    return found


def _cells(table: str) -> list[list[str]]:
    lines = [line for line in table.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines]


def _row(cells: list[str]) -> Row:
    what, measured, goal, met, *how = cells
    return Row(what, measured, goal, _VERDICTS[met], "|".join(how))


def _run(head: str) -> str:
    found = _RUN.search(head)
    return " ".join(found.groups()) if found else "of an unknown day"
