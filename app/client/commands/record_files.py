"""Files that commands read: a CSV, JSON or YAML as records with their lines, and a JSON or YAML of one mapping.

Nested fields of a record have their path as name, `pose.x`.
"""

from __future__ import annotations

import csv
import enum
import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from ..pose_rows import ONE_DECIMAL_SIGN, csv_rows, decoded, mixed_decimal_signs
from .console import OptionRefused

FORMATS = {".csv": "csv", ".txt": "csv", ".tsv": "csv", ".json": "json", ".yaml": "yaml", ".yml": "yaml"}


class RecordFormat(enum.StrEnum):
    """Formats of files of records."""

    csv = "csv"
    json = "json"
    yaml = "yaml"


FileFormat = Annotated[
    RecordFormat | None, typer.Option("--format", help="Format of the file.  [default: by its name]")
]
Delimiter = Annotated[
    str | None, typer.Option(help="Of a CSV's columns, or tab.  [default: by the first line]")
]


_RESTATED = re.compile(r"[-+]?(?:0[0-7_]+|[1-9][0-9_]*(?::[0-5]?[0-9])+|[0-9]+_[0-9_]*)(?:\.[0-9_]*)?")
"""Numbers that YAML 1.1 reads as others than people: octal 010, base 60 in 1:30, and 1_2 as 12."""


class FileRefused(OptionRefused):
    """A file that cannot be read."""


@dataclass(frozen=True, slots=True)
class Record:
    """One entry of a file: its place, its name if it has one, its fields by their paths."""

    place: str
    name: str | None
    fields: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Records:
    """The records of a file; `delimiter` of a CSV."""

    kind: str
    entries: list[Record]
    delimiter: str | None = None


def read_records(path: Path, kind: str | None, delimiter: str | None) -> Records:
    """Return the records of a file.

    `kind` is csv, json or yaml, by default as the file's name has it; `delimiter` of a CSV, by default the one its
    first line has most of. Raises FileRefused.
    """
    kind = kind or FORMATS.get(path.suffix.lower())
    if kind is None:
        raise FileRefused(
            f"The format of {path.name} is unknown by its name.", "Give --format csv, json or yaml."
        )
    text = _read_text(path)
    if kind == "csv":
        return _csv_records(text, delimiter)
    entries = _entries(_parsed_json(text), {}) if kind == "json" else _yaml_records(text)
    return Records(kind, list(entries))


def refuse_mixed_signs(records: Records, columns: Iterable[str]) -> None:
    """Raise FileRefused where some numbers in columns of a CSV have a decimal comma and some a point."""
    if records.delimiter in (None, ","):
        return
    names = list(columns)
    mixed = mixed_decimal_signs(
        (entry.place, name, str(entry.fields.get(name, ""))) for entry in records.entries for name in names
    )
    if mixed is not None:
        raise FileRefused(f"Numbers have both a comma and a point: {mixed}.", f"{ONE_DECIMAL_SIGN}.")


def as_delimiter(text: str | None) -> str | None:
    """Return the delimiter that an option gives: one character, or `tab`. Raises FileRefused."""
    if text in (None, "tab", "\\t"):
        return "\t" if text else None
    if text is not None and len(text) != 1:
        raise FileRefused("--delimiter is one character, or tab.")
    return text


def read_mapping(path: Path) -> dict[str, Any]:
    """Return the mapping that a JSON or YAML file holds. Raises FileRefused."""
    content = read_structure(path)
    if not isinstance(content, dict):
        raise FileRefused(f"{path} does not hold fields with their values.", 'Write {"name": ..., ...}.')
    return {str(name): value for name, value in content.items()}


def read_structure(path: Path) -> Any:
    """Return what a JSON or YAML file holds. Raises FileRefused."""
    text = _read_text(path)
    return _parsed_json(text) if path.suffix.lower() == ".json" else _parsed_yaml(text)[0]


def _read_text(path: Path) -> str:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise FileRefused(f"{path} cannot be read: {error.strerror}.") from error
    return decoded(data)


def _csv_records(text: str, delimiter: str | None) -> Records:
    rows, delimiter = csv_rows(text, delimiter)
    try:
        names = [name.strip() for name in next(rows)]
    except StopIteration:
        raise FileRefused("The file is empty.") from None
    except csv.Error as error:
        raise FileRefused(f"Line 1 cannot be read: {error}.", "Save the table as CSV text again.") from None
    if len(set(names)) != len(names):
        repeated = sorted({name for name in names if names.count(name) > 1})
        raise FileRefused(
            f"Line 1 has columns more than once: {', '.join(repeated)}.", "Rename them in the file."
        )
    entries = []
    try:
        for row in rows:
            if not any(cell.strip() for cell in row):
                continue
            if len(row) != len(names):
                raise FileRefused(
                    f"Line {rows.line_num} has {len(row)} cells, the header {len(names)}.",
                    "Check the delimiter (--delimiter) and that the line is complete.",
                )
            cells = {name: cell.strip() for name, cell in zip(names, row, strict=True)}
            entries.append(Record(f"line {rows.line_num}", None, cells))
    except csv.Error as error:
        raise FileRefused(f"Line {rows.line_num} is not a row of a CSV: {error}.") from error
    return Records("csv", entries, delimiter)


def _parsed_json(text: str) -> Any:
    try:
        return json.loads(text)
    except RecursionError:
        raise FileRefused("The JSON is nested too deeply.") from None
    except json.JSONDecodeError as error:
        raise FileRefused(f"Line {error.lineno} is not JSON: {error.msg}.") from error


def _parsed_yaml(text: str, *, of_records: bool = False) -> tuple[Any, Any]:
    """Return the content of a YAML, and the tree of its nodes; of records no number that people read otherwise."""
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        for event in yaml.parse(text, Loader=loader):
            where = f"Line {event.start_mark.line + 1}" if event.start_mark is not None else "The file"
            if isinstance(event, yaml.AliasEvent):  # a few lines with aliases may expand to millions of poses
                raise FileRefused(
                    f"{where} refers to another place of the file (*{event.anchor}).",
                    "Save the file without anchors and aliases, or as JSON or CSV.",
                )
            if not of_records or not isinstance(event, yaml.ScalarEvent) or not event.implicit[0]:
                continue
            if _RESTATED.fullmatch(event.value):
                raise FileRefused(
                    f"{where} has {event.value}, which YAML reads as {yaml.safe_load(event.value)}.",
                    "Put a name in quotes, and write a number in decimal digits without zeros before it.",
                )
        content = yaml.load(text, Loader=loader)  # noqa: S506 - a safe loader, in C if available
        tree = yaml.compose(text, Loader=loader)
    except RecursionError:
        raise FileRefused("The YAML is nested too deeply.") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"Line {mark.line + 1}" if mark is not None else "The file"
        raise FileRefused(f"{where} is not YAML: {getattr(error, 'problem', None) or error}.") from error
    return content, tree


def _yaml_records(text: str) -> Iterator[Record]:
    import yaml

    content, tree = _parsed_yaml(text, of_records=True)
    lines: dict[int, int] = {}
    if isinstance(tree, yaml.MappingNode):
        lines = {i: key.start_mark.line + 1 for i, (key, _) in enumerate(tree.value)}
    elif isinstance(tree, yaml.SequenceNode):
        lines = {i: node.start_mark.line + 1 for i, node in enumerate(tree.value)}
    return _entries(content, lines)


def _entries(content: Any, lines: dict[int, int]) -> Iterator[Record]:
    """Yield the entries of a list, of a mapping by their names, or of `items` in a list of the service."""
    if isinstance(content, dict) and isinstance(content.get("items"), list):
        content, lines = content["items"], {}
    named: Iterable[tuple[str | None, Any]]
    if isinstance(content, dict):
        if nameless := [name for name in content if name is None or isinstance(name, bool)]:
            raise FileRefused(f"The name of a pose is read as {nameless[0]}, no text.", "Put it in quotes.")
        named = [(str(name), entry) for name, entry in content.items()]
    elif isinstance(content, list):
        named = [(None, entry) for entry in content]
    else:
        raise FileRefused(
            "The file holds neither a list of poses nor a mapping from names to poses.",
            'Write [{"pose_id": "P1", "position_mm": [x, y, z]}, ...].',
        )
    for index, (name, entry) in enumerate(named):
        place = f"line {lines[index]}" if index in lines else f"entry {index + 1}"
        if not isinstance(entry, dict):
            raise FileRefused(f"In {place} there is a {type(entry).__name__}, not a pose.")
        yield Record(place, name, dict(_flat(entry, "")))


def _flat(entry: dict[Any, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for name, value in entry.items():
        path = f"{prefix}{name}"
        if isinstance(value, dict):
            yield from _flat(value, f"{path}.")
        else:
            yield path, value
