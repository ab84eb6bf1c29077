"""Analyses as CSV tables (RFC 4180): a row for each entry of a list in the document, a column for each value.

Tables and columns follow from the response's schema, so that a table's header is the same whatever was measured.
Nested objects are columns too, their keys joined by `_`; vectors of three are x, y, z, intervals low and high, before
the unit. Matrices are in the JSON alone; tables of lists have them in one cell, row after row. A list within a list is
a table of its own, which begins with what identifies the outer entry. `summary` is one row of everything that is in no
list.

A cell of text that a spreadsheet would take for a formula is preceded by an apostrophe (OWASP, CSV injection).
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from pydantic import BaseModel

from app.markup import guarded

SUMMARY = "summary"
_UNIT = re.compile(r"(_(?:mm|deg|px|rad|s))?$")
_PARTS = {3: ("x", "y", "z"), 2: ("low", "high")}
_PIXEL = re.compile(r"_middle_px$")
"""Pairs of image coordinates, which are no interval."""
_ANGLES = "roll_pitch_yaw"
Json = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Column:
    """A header, and the keys and places that lead from a row's object to its value."""

    name: str
    path: tuple[str | int, ...]


@dataclass(frozen=True, slots=True)
class Table:
    """`steps` lead from the document to a list, and from each of its entries to the next list; none for one row.

    `outer` identifies the entry of each list but the last; None where its number, from 1, does.
    """

    name: str
    steps: tuple[tuple[str, ...], ...]
    outer: tuple[Column | None, ...]
    columns: tuple[Column, ...]

    @property
    def header(self) -> list[str]:
        """The names of the columns, in their order."""
        numbers = (step[-1] for step in self.steps)
        outer = [
            column.name if column else number for column, number in zip(self.outer, numbers, strict=False)
        ]
        return [*outer, *(column.name for column in self.columns)]


@cache
def tables_of(model: type[BaseModel], *, with_matrices: bool = False) -> Mapping[str, Table]:
    """Return the tables of a response by their names: `poses`, `poses.outliers`, and `summary`."""
    schema = model.model_json_schema(mode="serialization")
    walker = _Walker(schema.get("$defs", {}), with_matrices=with_matrices)
    summary = Table(SUMMARY, (), (), tuple(walker.columns(schema)))
    return {table.name: table for table in (summary, *walker.tables(schema))}


def write_table(table: Table, document: Json) -> str:
    """Return a table of a document as text, header first, with the numbers that the document has."""
    text = io.StringIO()
    rows = csv.writer(text)  # commas, CRLF, quotes where needed: RFC 4180
    rows.writerow(table.header)
    for outer, entry in _entries(table, document):
        rows.writerow([*outer, *(_cell(_value(entry, column.path)) for column in table.columns)])
    return text.getvalue()


class _Walker:
    """Reads a JSON schema whose references are among `definitions`."""

    def __init__(self, definitions: Json, *, with_matrices: bool) -> None:
        self._definitions = definitions
        self._objects = {"object"} if with_matrices else {"object", "array"}

    def columns(self, node: Json, path: tuple[str, ...] = ()) -> Iterator[Column]:
        """Yield the columns of an object, those of objects in it too."""
        for key, value in self._properties(node):
            at = (*path, key)
            name = "_".join(at)
            if value.get("type") == "object":
                yield from self.columns(value, at)
            elif value.get("type") != "array":
                yield Column(name, at)
            elif (kind := self._resolved(value["items"]).get("type")) not in self._objects:
                parts = _PARTS.get(value.get("maxItems", 0)) if kind == "number" else None
                if parts is None:
                    yield Column(name, at)  # its items in one cell
                elif _ANGLES in name:
                    for place, angle in enumerate(_ANGLES.split("_")):
                        yield Column(name.replace(_ANGLES, angle), (*at, place))
                else:
                    if _PIXEL.search(name):
                        parts = ("u", "v")
                    for place, part in enumerate(parts):
                        yield Column(_UNIT.sub(rf"_{part}\1", name, count=1), (*at, place))

    def tables(
        self,
        node: Json,
        path: tuple[str, ...] = (),
        steps: tuple[tuple[str, ...], ...] = (),
        outer: tuple[Column | None, ...] = (),
    ) -> Iterator[Table]:
        """Yield the tables of an object's lists, those of lists in them too."""
        for key, value in self._properties(node):
            at = (*path, key)
            if value.get("type") == "object":
                yield from self.tables(value, at, steps, outer)
            elif value.get("type") == "array":
                item = self._resolved(value["items"])
                if item.get("type") == "object":
                    inner = (*steps, at)
                    name = ".".join(word for step in inner for word in step)
                    yield Table(name, inner, outer, tuple(self.columns(item)))
                    yield from self.tables(item, (), inner, (*outer, self._identity(item)))

    def _identity(self, item: Json) -> Column | None:
        """Return the column that identifies an entry: its first value, unless that is no text and no whole number."""
        key, value = next(self._properties(item))
        return Column(key, (key,)) if value.get("type") in ("string", "integer") else None

    def _properties(self, node: Json) -> Iterator[tuple[str, Json]]:
        for key, value in node.get("properties", {}).items():
            yield key, self._resolved(value)

    def _resolved(self, node: Json) -> Json:
        """Return a node without references and null."""
        if "anyOf" in node:
            node = next(part for part in node["anyOf"] if part.get("type") != "null")
        if "$ref" in node:
            return self._resolved(self._definitions[node["$ref"].rpartition("/")[2]])
        return node


def _entries(table: Table, document: Json) -> Iterator[tuple[list[str], Json]]:
    """Yield each entry of a table with the cells that identify the entries around it."""
    found: list[tuple[list[str], Json]] = [([], document)]
    for depth, step in enumerate(table.steps):
        inner = []
        for outer, entry in found:
            for number, item in enumerate(_value(entry, step) or [], start=1):
                own = outer
                if depth < len(table.outer):
                    column = table.outer[depth]
                    own = [*outer, _cell(_value(item, column.path)) if column else str(number)]
                inner.append((own, item))
        found = inner
    yield from found


def _value(entry: Any, path: tuple[str | int, ...]) -> Any:
    for key in path:
        if entry is None:
            return None
        # A coefficient that the lens model does not have is absent.
        entry = entry.get(key) if isinstance(entry, dict) else entry[key]
    return entry


def _within(values: list[Any]) -> Iterator[str]:
    """Yield the items of a list, and of lists in it."""
    for value in values:
        if isinstance(value, list):
            yield from _within(value)
        else:
            yield str(value)


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        return guarded("; ".join(_within(value)))
    return guarded(value) if isinstance(value, str) else repr(value)
