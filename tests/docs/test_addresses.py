"""Addresses that the documents show with curl, and tables that they name, are those of the service."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from app.api.representations.analysis_answers import DEFAULT_TABLES
from app.api.representations.analysis_tables import tables_of
from app.api.schemas.analyses.camera_poses import CameraPosesAnalysis
from app.api.schemas.analyses.comparison import ComparisonAnalysis
from app.api.schemas.analyses.dh.compensation import Compensation
from app.api.schemas.analyses.dh.identification import DhAnalysis
from app.api.schemas.analyses.dh.joint_noise import JointNoiseAnalysis
from app.api.schemas.analyses.dh.kinematic_error import KinematicErrorAnalysis
from app.api.schemas.analyses.dh.next_view import NextViewAnalysis
from app.api.schemas.analyses.dh.plan import DhPlan
from app.api.schemas.analyses.hand_eye import HandEyeAnalysis
from app.api.schemas.analyses.intrinsics import IntrinsicsAnalysis
from app.api.schemas.analyses.qualification import QualificationAnalysis
from app.api.schemas.analyses.repeatability import RepeatabilityAnalysis
from app.api.schemas.documents.histories import ReportComparison, RobotHistory

PROJECT = Path(__file__).parents[2]
PAGES = [PROJECT / "README.md", *sorted((PROJECT / "docs").glob("**/*.md"))]
_DOCUMENT: dict[str, Any] = json.loads((PROJECT / "openapi.json").read_text(encoding="utf-8"))
CONTRACT: dict[str, dict[str, Any]] = _DOCUMENT["paths"]
BASE = "http://127.0.0.1:8000/v1"
"""What `URL` stands for on every page: README.md and docs/quickstart.md set it."""
_BLOCK = re.compile(r"^```(?:sh|console)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_SENDING = ("--json", "-F", "-d", "--data", "--data-binary", "--data-urlencode")
OF_EVERY = frozenset({"summary", "subject.targets", "excluded", "warnings"})
TABLES: dict[str, tuple[str, type[BaseModel]]] = {
    "`intrinsics`": ("intrinsics", IntrinsicsAnalysis),
    "`camera-poses`": ("camera_poses", CameraPosesAnalysis),
    "`hand-eye`": ("hand_eye", HandEyeAnalysis),
    "`repeatability`": ("repeatability", RepeatabilityAnalysis),
    "`dh`": ("dh", DhAnalysis),
    "`dh/error-map`": ("kinematic_error", KinematicErrorAnalysis),
    "`joint-noise`": ("joint_noise", JointNoiseAnalysis),
    "`comparison`": ("comparison", ComparisonAnalysis),
    "`qualification`": ("qualification", QualificationAnalysis),
    "`next-view`": ("next_view", NextViewAnalysis),
    "`dh-plan` of a robot": ("dh_plan", DhPlan),
    "`compensate` of a robot": ("compensation", Compensation),
    "`history` of a robot": ("history", RobotHistory),
    "`comparison` of reports": ("report_comparison", ReportComparison),
}
"""Of each row of the table in docs/results.md the analysis and its answer."""


def commands(text: str) -> Iterator[list[str]]:
    """The words of every curl command in the blocks of a page."""
    for block in _BLOCK.findall(text):
        for line in block.replace("\\\n", " ").splitlines():
            line = line.removeprefix("$ ")
            if line.startswith("curl "):
                yield shlex.split(line, comments=True)


def problem_of(words: list[str]) -> str | None:
    """Say what is wrong with the address of a curl command, if anything."""
    addresses = [word for word in words if word.startswith(("$URL", "$GRIDPOSE_URL", "http"))]
    if len(addresses) != 1:
        return "not one address"
    if addresses[0].startswith("https://"):
        return None  # a file to download
    address, _, query = addresses[0].partition("?")
    if not address.startswith("$URL/"):
        return "does not begin with $URL"
    path = "/v1" + address.removeprefix("$URL")
    sends = any(word in _SENDING for word in words)
    method = words[words.index("-X") + 1].lower() if "-X" in words else "get"
    if method == "get" and sends and "-G" not in words:
        method = "post"
    for known, operations in CONTRACT.items():
        pattern = re.sub(r"\\{\w+\\}", r"[\\w$-]+", re.escape(known))
        if re.fullmatch(pattern, path):
            if method not in operations:
                return f"{known} does not take {method}"
            names = set(re.findall(r"(?:^|&)(\w+)=", query))
            if "-G" in words:
                names |= {w.partition("=")[0] for flag, w in pairwise(words) if flag in _SENDING}
            known_names = {one["name"] for one in operations[method].get("parameters", []) if "name" in one}
            return f"{known} does not take {names - known_names}" if names - known_names else None
    return "is no path of openapi.json"


def test_commands_are_those_of_the_contract() -> None:
    found = [
        (f"{page.relative_to(PROJECT)}: {' '.join(words)}", problem_of(words))
        for page in PAGES
        for words in commands(page.read_text(encoding="utf-8"))
    ]
    assert len(found) > 15
    assert [(shown, problem) for shown, problem in found if problem] == []


def test_url_stands_for_one_address() -> None:
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert set(re.findall(r"\bexport URL=(\S+)", text)) == {BASE}


@pytest.mark.parametrize(
    "command",
    [
        'curl -H "$AUTH" $URL/v1/sessions/$SESSION/dh',
        'curl -H "$AUTH" $URL/sessions/$SESSION/dhh',
        'curl -H "$AUTH" "$URL/sessions/$SESSION/dh?metod=cpa"',
        'curl -X DELETE -H "$AUTH" $URL/targets',
        'curl -H "$AUTH" "$GRIDPOSE_URL/v1/targets"',
    ],
)
def test_a_wrong_command_is_seen(command: str) -> None:
    (words,) = commands(f"```sh\n{command}\n```\n")
    assert problem_of(words) is not None


def test_tables_are_those_of_the_service() -> None:
    page = (PROJECT / "docs" / "results.md").read_text(encoding="utf-8")
    section = page.split("| analysis | `table`")[1].split("\n\n")[0]
    rows = {
        name: re.findall(r"`([\w.]+)`", cell)
        for name, cell in re.findall(r"^\| (`.*?) \| (.*) \|$", section, re.MULTILINE)
    }
    assert set(rows) == set(TABLES)
    for name, (analysis, model) in TABLES.items():
        assert rows[name][0] == DEFAULT_TABLES[analysis], name
        assert set(rows[name]) | OF_EVERY == set(tables_of(model)) | OF_EVERY, name


def test_every_answer_with_tables_is_in_the_document() -> None:
    contents = [
        operation["responses"].get("200", {}).get("content", {})
        for operations in CONTRACT.values()
        for operation in operations.values()
    ]
    models = {
        content["application/json"]["schema"]["$ref"].rpartition("/")[2]
        for content in contents
        if {"application/json", "text/csv"} <= set(content)
    }
    schemas = _DOCUMENT["components"]["schemas"]
    pages = {name for name in models if "next_cursor" in schemas[name]["properties"]}  # one table, no name
    assert models - pages == {model.__name__ for _, model in TABLES.values()}
    assert {analysis for analysis, _ in TABLES.values()} == set(DEFAULT_TABLES)
