"""Single values of an instrument's file that are no number, or that YAML reads as another value than people do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from app.client.commands.measured_poses.layout import ColumnLayout
from app.client.commands.measured_poses.parser import parse_poses
from app.client.commands.record_files import FileRefused, read_records


def write(folder: Path, text: str, name: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def read(path: Path) -> tuple[list[dict[str, Any]], list[tuple[str, str]]]:
    found, problems = parse_poses(read_records(path, None, None), ColumnLayout())
    return [reading for _, reading in found], [(p.place, p.message) for p in problems]


@pytest.mark.parametrize(
    ("field", "value", "named"),
    [
        ("position_mm", '["1,5", 2, 3]', "position_mm.0"),
        ("position_mm", "[1, 2, NaN]", "position_mm.2"),
        ("rotation", "[[1, 0, 0], [0, 1, Infinity], [0, 0, 1]]", "rotation.1.2"),
        ("joint_angles_deg", "[true]", "joint_angles_deg.0"),
        ("cycle", "1" * 400, "cycle"),
        ("pose_id", "7", "quotes"),
    ],
)
def test_what_is_no_number_is_named_in_the_service_s_own_form(
    tmp_path: Path, field: str, value: str, named: str
) -> None:
    entry = {"pose_id": '"P1"', "position_mm": "[1, 2, 3]", field: value}
    text = ", ".join(f'"{name}": {one}' for name, one in entry.items())
    readings, problems = read(write(tmp_path, f"[{{{text}}}]", "p.json"))
    assert readings == []
    assert problems[0][0] == "entry 1"
    assert named in problems[0][1]


def test_a_number_too_large_in_json_is_named(tmp_path: Path) -> None:
    text = f'[{{"x": {"1" * 400}, "y": 1, "z": 2}}, {{"x": 1, "y": 2, "z": 3, "joints": [1, NaN]}}]'
    _, problems = read(write(tmp_path, text, "p.json"))
    assert [message.partition(":")[0] for _, message in problems] == [
        "x is not finite",
        "joints.1 is not finite",
    ]


@pytest.mark.parametrize("number", ["007", "1_2", "1:30", "1_0.5", "-010"])
def test_numbers_that_yaml_reads_as_others_are_refused(tmp_path: Path, number: str) -> None:
    for text in (f"- {{pose: {number}, x: 1, y: 2, z: 3}}", f"- {{pose: P1, x: {number}, y: 2, z: 3}}"):
        with pytest.raises(FileRefused, match=f"Line 1 has {number}, which YAML reads as"):
            read(write(tmp_path, text, "p.yaml"))
    ((reading,), _) = read(
        write(tmp_path, f"- {{pose: '{number.replace(':', '.')}', x: 0.5, y: 0, z: -1.5e+2}}", "p.yaml")
    )
    assert reading["position_mm"] == [0.5, 0.0, -150.0]


@pytest.mark.parametrize(
    "text", ["- {pose: no, x: 1, y: 2, z: 3}", "- {pose_id: no, position_mm: [1, 2, 3]}"]
)
def test_a_pose_that_yaml_reads_as_false_asks_for_quotes(tmp_path: Path, text: str) -> None:
    ((_, message),) = read(write(tmp_path, text, "p.yaml"))[1]
    assert "quotes" in message
