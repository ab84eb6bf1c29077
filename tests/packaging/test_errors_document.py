"""docs/errors.md lists every code that the sources answer, store or print, and every warning."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from app.api.problems import _HTTP_CODES
from app.services.queries import NOUNS
from core.kinematics.correction import Outcome

PROJECT = Path(__file__).parents[2]
_CODE_OF = {
    "ArchiveRefused": 0,
    "BackupRefused": 0,
    "AnalysisError": 0,
    "ArgumentRefused": 0,
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
_WARNING_CODE_OF = {"Advisory": 0, "_warning": None}
"""Calls that make a warning: which argument is its code, None where it is `code=` alone."""
_OTHER_WARNINGS: dict[str, set[str]] = {
    # The code is put together from words:
    "core/metrology/repeatability/outliers.py": {"position_clusters", "orientation_clusters"},
    "app/analyses/documents/dh/compensation.py": {
        f"command_{outcome}" for outcome in (Outcome.IN_GAP, Outcome.NEAR_SINGULARITY)
    },
    "core/session/robot/stated_angles.py": {
        "joint_angles_missing",
        "joint_angles_inconsistent",
        "rotations_missing",
    },
    "core/session/robot/coupling_proposal.py": {"joint_coupling_proposed"},
    "core/session/absolute_poses.py": {"target_shape_dominates"},
    # The warning is one that was made elsewhere:
    "core/session/repeatability/assessment.py": set(),
}
"""Modules with a warning whose code is no text in the call, and what it may be."""


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
                names: list[ast.expr | None] = [getattr(line, "target", None)]
                if isinstance(line, ast.Assign):
                    names = [*line.targets]
                value = getattr(line, "value", None)
                if value is not None and any(isinstance(n, ast.Name) and n.id == "code" for n in names):
                    yield from texts(value)
        if isinstance(node, ast.Call):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in _WARNING_CODE_OF:
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


def warnings_of(tree: ast.AST) -> Iterator[str | None]:
    """The codes of the warnings that one module makes, and None for each whose code is no text."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in _WARNING_CODE_OF:
                place = _WARNING_CODE_OF[called]
                code = next((k.value for k in node.keywords if k.arg == "code"), None)
                if code is None and place is not None and len(node.args) > place:
                    code = node.args[place]
                stated: list[str | None] = [] if code is None else [*texts(code)]
                yield from stated or [None]


def sources() -> Iterator[tuple[str, ast.AST]]:
    for package in ("app", "core"):
        for path in sorted((PROJECT / package).rglob("*.py")):
            yield path.relative_to(PROJECT).as_posix(), ast.parse(path.read_text(encoding="utf-8"))


def table_rows(text: str) -> list[list[str]]:
    lines = [line for line in text.splitlines() if line.startswith("| `")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


def codes_in(rows: list[list[str]]) -> list[str]:
    return [code for row in rows for code in re.findall(r"`(\w+)`", row[0])]


@pytest.fixture(scope="module")
def codes() -> set[str]:
    found = {f"{noun}_not_found" for noun in NOUNS.values()} | {code for code, _ in _HTTP_CODES.values()}
    for _, tree in sources():
        found.update(codes_of(tree))
    return found - _ABSTRACT


@pytest.fixture(scope="module")
def document() -> tuple[list[list[str]], list[list[str]]]:
    """The rows of refusals and failures, and those of warnings."""
    text = (PROJECT / "docs" / "errors.md").read_text(encoding="utf-8")
    before, _, rest = text.partition("\n## Warnings\n")
    warnings, _, after = rest.partition("\n## ")
    return table_rows(before + after), table_rows(warnings)


def test_every_code_is_in_the_document(
    codes: set[str], document: tuple[list[list[str]], list[list[str]]]
) -> None:
    assert len(codes) > 100
    listed = set(codes_in(document[0]))
    assert codes - listed == set()
    # Made of a noun and a suffix where they are raised; or stored by a user, not by the program.
    made = {"position_outlier", "orientation_outlier", "request_refused", "excluded_by_user"}
    assert listed - codes == made


def test_every_warning_is_in_the_document(document: tuple[list[list[str]], list[list[str]]]) -> None:
    found: set[str] = set()
    without_text = set()
    for path, tree in sources():
        for code in warnings_of(tree):
            if code is None:
                without_text.add(path)
                found |= _OTHER_WARNINGS.get(path, set())
            else:
                found.add(code)
    assert without_text == set(_OTHER_WARNINGS)
    listed = codes_in(document[1])
    assert found - set(listed) == set()
    assert set(listed) - found == set()
    assert len(listed) == len(set(listed))


def test_a_warning_without_a_literal_code_is_seen() -> None:
    tree = ast.parse(
        'Advisory("a" if x else "b", "It is."), Advisory(name, "It is."), Advisory(code="c", detail="")'
    )
    assert list(warnings_of(tree)) == ["a", "b", None, "c"]


def test_every_code_has_a_cause_and_a_remedy(document: tuple[list[list[str]], list[list[str]]]) -> None:
    for row in document[0]:
        assert len(row) in (3, 4), row
        assert all(row), row
    for row in document[1]:
        assert len(row) == 4, row
        assert all(row), row
