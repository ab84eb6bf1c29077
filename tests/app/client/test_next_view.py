"""`gridpose sessions next-view` prints each view in a line, with what it gains."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from app.client.commands.record_files import FileRefused
from app.client.commands.sessions.next_view import poses_to_choose_from, print_views


def uncertainty(**known: float) -> dict[str, Any]:
    names = ("projection_rms_px", "focal_relative_uncertainty", "length_rms_mm", "angle_rms_deg")
    return {name: known.get(name) for name in names}


def printed(capsys: pytest.CaptureFixture[str], *views: dict[str, Any]) -> str:
    print_views({"suggestions": list(views), "warnings": []})
    return " ".join(capsys.readouterr().out.split())


def test_a_view_of_a_camera_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    view = {
        "instruction": "tilt 43° about x (upper edge away), target in the middle, 412 mm away",
        "joint_angles_deg": None,
        "T_target_camera": [[1.0, 0.0, 0.0, 5.0]],
        "expected_uncertainty_now": uncertainty(projection_rms_px=0.01388, focal_relative_uncertainty=0.01),
        "expected_uncertainty_after": uncertainty(projection_rms_px=0.01172, focal_relative_uncertainty=0.01),
    }
    other = {**view, "T_target_camera": [[1.0, 0.0, 0.0, 6.0]]}
    text = printed(capsys, view, other, view)
    assert (
        "1. tilt 43° about x (upper edge away), target in the middle, 412 mm away: 0.014 -> 0.012 px" in text
    )
    assert "2. tilt 43°" in text
    assert "3. view 1 once more: tilt 43°" in text
    assert "joints" not in text


def test_a_view_of_a_robot_has_its_joint_angles(capsys: pytest.CaptureFixture[str]) -> None:
    view = {
        "instruction": "face the target squarely",
        "joint_angles_deg": [1.0, -20.126],
        "T_target_camera": [[1.0, 0.0, 0.0, 5.0]],
        "expected_uncertainty_now": uncertainty(length_rms_mm=0.5, angle_rms_deg=0.02),
        "expected_uncertainty_after": uncertainty(length_rms_mm=0.4, angle_rms_deg=0.01),
    }
    text = printed(capsys, view)
    assert "1. face the target squarely: 0.50 -> 0.40 mm, 0.020 -> 0.010 ° joints 1.00, -20.13 °" in text


def test_candidates_are_the_joint_angles_of_a_file_of_poses(tmp_path: Path) -> None:
    table = tmp_path / "program.csv"
    table.write_text(
        "pose_id;x_mm;y_mm;z_mm;j1_deg;j2_deg\nA;1;2;3;10,5;-20\nB;4;5;6;11;-21\n", encoding="utf-8"
    )
    found = poses_to_choose_from(table)
    assert found == [{"joint_angles_deg": [10.5, -20.0]}, {"joint_angles_deg": [11.0, -21.0]}]
    listed = tmp_path / "program.json"
    listed.write_text('[{"pose_id": "A", "joint_angles_deg": [1.0, 2.0]}]', encoding="utf-8")
    assert poses_to_choose_from(listed) == [{"joint_angles_deg": [1.0, 2.0]}]


@pytest.mark.parametrize(
    "text", ["pose_id,x_mm,y_mm,z_mm\nA,1,2,3\n", "pose_id,j1_deg\nA,ten\n", "pose_id,j1_deg\n"]
)
def test_a_file_without_joint_angles_is_refused(tmp_path: Path, text: str) -> None:
    table = tmp_path / "program.csv"
    table.write_text(text, encoding="utf-8")
    with pytest.raises(FileRefused):
        poses_to_choose_from(table)
