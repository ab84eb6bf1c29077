"""Exports of results, from the answers of a real run that openapi.json has as examples."""

from __future__ import annotations

import csv
import io
import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from app.client.commands.console import OptionRefused
from app.client.commands.exports.camera_poses import _csv
from app.client.commands.exports.hand_eye import _content, _json, _ros, _yaml
from app.client.commands.output_files import write_text
from app.client.results import Analysis

PROJECT = Path(__file__).parents[3]
CONTRACT = json.loads((PROJECT / "openapi.json").read_text(encoding="utf-8"))


def answer(kind: str) -> Any:
    responses = CONTRACT["paths"][f"/v1/sessions/{{session_id}}/{kind}"]["get"]["responses"]
    content = responses["200"]["content"]["application/json"]
    return content["example"] if "example" in content else next(iter(content["examples"].values()))["value"]


def test_hand_eye_as_yaml_json_and_ros_agree() -> None:
    found = answer("hand-eye")
    content = yaml.safe_load(_yaml(_content(found)))
    assert content == json.loads(_json(_content(found)))
    matrix = np.array(content["T_flange_camera"]["matrix"])
    x, y, z, w = content["T_flange_camera"]["quaternion_xyzw"]
    np.testing.assert_allclose(Rotation.from_quat([x, y, z, w]).as_matrix(), matrix[:3, :3], atol=1e-5)
    commands = [
        shlex.split(line)
        for line in _ros(found, "tool0", "cam", "base", "board").splitlines()
        if line[0] != "#"
    ]
    assert len(commands) == 1 + len(found["base_targets"])
    options = dict(zip(commands[0][4::2], commands[0][5::2], strict=True))
    position_m = [float(options[f"--{axis}"]) for axis in "xyz"]
    np.testing.assert_allclose(position_m, matrix[:3, 3] / 1000.0, atol=1e-8)
    assert (options["--frame-id"], options["--child-frame-id"]) == ("tool0", "cam")


def test_camera_poses_are_a_table_with_a_row_for_each_image() -> None:
    images = answer("camera-poses")["camera_poses"]
    rows = list(csv.DictReader(io.StringIO(_csv(images))))
    assert [row["measurement_id"] for row in rows] == [image["measurement_id"] for image in images]
    with_pose = next(n for n, image in enumerate(images) if image["pose"] is not None)
    assert {row["used"] for row in rows} <= {"true", "false"}
    x, y, z, w = (float(rows[with_pose][name]) for name in ("qx", "qy", "qz", "qw"))
    assert all(
        len(rows[with_pose][name].lstrip("-")) <= len("0.1234567890") for name in ("qx", "qy", "qz", "qw")
    )
    R = Rotation.from_quat([x, y, z, w]).as_matrix()
    np.testing.assert_allclose(R, images[with_pose]["pose"]["rotation"], atol=1e-5)
    assert _csv([]) == ""


@pytest.mark.parametrize(
    "kind", ["repeatability", "camera-poses", "hand-eye", "dh", "intrinsics", "comparison"]
)
def test_the_table_of_an_analysis_has_flat_rows(kind: str) -> None:
    analysis = Analysis(kind, answer(kind))
    assert analysis.rows
    assert all(not isinstance(value, dict) for row in analysis.rows for value in row.values())
    assert all(isinstance(text, str) for text in analysis.warnings)


def test_an_export_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    write_text("text\n", tmp_path / "file.csv")
    assert (tmp_path / "file.csv").read_text() == "text\n"
    with pytest.raises(OptionRefused, match="cannot be written"):
        write_text("text\n", tmp_path / "nowhere" / "file.csv")
