"""docs/errors.md lists every code that the sources answer, store or print when something is refused or fails."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from app.api.problems import _HTTP_CODES
from app.services.queries import NOUNS

PROJECT = Path(__file__).parents[2]
_CODE_OF = {
    "ArchiveRefused": 0,
    "BackupRefused": 0,
    "AnalysisError": 0,
    "ClientError": 0,
    "ExcludedMeasurement": 1,
    "ExcludedPose": 1,
    "Outlier": 1,
    "Failure": 0,
    "InstallationRefused": 0,
    "AnalysisRefused": 0,
    "_exclude": 2,
    "_fail": 1,
    "problem_response": 1,
}
"""Which argument of these calls is a code."""
_ABSTRACT = frozenset(
    {
        *("gridpose_error", "invalid_input", "image_error", "detection_error", "estimation_error"),
        *("kinematics_error", "session_error", "service_error"),
    }
)
"""Codes of classes of which only subclasses are raised."""


def texts(node: ast.expr) -> Iterator[str]:
    """Every text an expression may be: a constant, or those of a choice."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.IfExp):
        yield from texts(node.body)
        yield from texts(node.orelse)
    elif isinstance(node, ast.BoolOp):
        for value in node.values:
            yield from texts(value)


def codes_of(tree: ast.AST) -> Iterator[str]:
    """The codes in one module: class attributes, `code=` in calls, and the codes of `_CODE_OF`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            for line in node.body:
                names = line.targets if isinstance(line, ast.Assign) else [getattr(line, "target", None)]
                value = getattr(line, "value", None)
                if value is not None and any(isinstance(n, ast.Name) and n.id == "code" for n in names):
                    yield from texts(value)
        if isinstance(node, ast.Call):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called == "Advisory":  # a warning, which travels with a result
                continue
            for keyword in node.keywords:
                if keyword.arg == "code":
                    yield from texts(keyword.value)
            place = _CODE_OF.get(called, len(node.args))
            if place < len(node.args):
                yield from texts(node.args[place])
            if called == "of" and isinstance(node.func, ast.Attribute) and node.args:
                owner = node.func.value
                if isinstance(owner, ast.Name) and owner.id == "NotFound":
                    yield from (f"{noun}_not_found" for noun in texts(node.args[0]))


@pytest.fixture(scope="module")
def codes() -> set[str]:
    found = {f"{noun}_not_found" for noun in NOUNS.values()} | {code for code, _ in _HTTP_CODES.values()}
    for package in ("app", "core"):
        for path in (PROJECT / package).rglob("*.py"):
            found.update(codes_of(ast.parse(path.read_text(encoding="utf-8"))))
    return found - _ABSTRACT


@pytest.fixture(scope="module")
def rows() -> list[list[str]]:
    text = (PROJECT / "docs" / "errors.md").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line.startswith("| `")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


def test_every_code_stands_in_the_document(codes: set[str], rows: list[list[str]]) -> None:
    assert len(codes) > 100
    listed = {code for row in rows for code in re.findall(r"`(\w+)`", row[0])}
    assert codes - listed == set()
    # Made of a noun and a suffix where they are raised; or stored by a user, not by the program.
    made = {"position_outlier", "orientation_outlier", "request_refused", "excluded_by_user"}
    assert listed - codes == made


def test_every_code_has_a_cause_and_a_remedy(rows: list[list[str]]) -> None:
    for row in rows:
        assert len(row) in (3, 4), row
        assert all(row), row
