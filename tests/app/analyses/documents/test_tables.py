"""Analyses as CSV: read back, the tables hold the numbers of the JSON; and no cell is a formula."""

from __future__ import annotations

import csv
import io
from typing import Any

import pytest

from tests.support.sessions.robot_session import ANALYSES, FORMULA, RobotSession

CSV = "text/csv"


def read(response: Any) -> list[dict[str, str]]:
    assert response.headers["content-type"].startswith("text/csv")
    assert "\r\n" in response.text
    header = next(csv.reader(io.StringIO(response.text, newline="")))
    assert len(set(header)) == len(header)
    return list(csv.DictReader(io.StringIO(response.text, newline=""), strict=True))


def number(cell: str) -> float | None:
    return float(cell) if cell else None


def test_repeatability_is_the_same_in_a_spreadsheet(robot_session: RobotSession) -> None:
    document = robot_session.get("repeatability").json()
    rows = read(robot_session.get("repeatability", CSV))
    assert [row["pose_id"] for row in rows] == [pose["pose_id"] for pose in document["poses"]]
    for row, pose in zip(rows, document["poses"], strict=True):
        assert int(row["cycles"]) == pose["cycles"]
        assert row["verdict"] == pose["verdict"]
        for name, value in pose["repeatability"].items():
            assert number(row[f"repeatability_{name}"]) == value
        position = pose["mean"]["position_mm"] or [None] * 3
        assert [number(row[f"mean_position_{axis}_mm"]) for axis in "xyz"] == position
        interval = pose["interval"]["rp_l_mm"] or [None, None]
        assert [number(row[f"interval_rp_l_{end}_mm"]) for end in ("low", "high")] == interval
        assert row["accuracy_ap_p_mm"] == ""


def test_a_list_within_a_list_is_a_table_of_its_own(robot_session: RobotSession) -> None:
    document = robot_session.get("repeatability").json()
    rows = read(robot_session.get("repeatability", CSV, table="poses.excluded"))
    expected = [
        (pose["pose_id"], one["measurement_id"], one["code"])
        for pose in document["poses"]
        for one in pose["excluded"]
    ]
    assert [(row["pose_id"], row["measurement_id"], row["code"]) for row in rows] == expected
    groups = robot_session.get("intrinsics").json()["groups"]
    rows = read(robot_session.get("intrinsics", CSV, table="groups.highest_residuals"))
    assert [(row["focus_group"], number(row["rms_px"])) for row in rows] == [
        (group["focus_group"], one["rms_px"]) for group in groups for one in group["highest_residuals"]
    ]


def test_the_robot_is_the_same_in_a_spreadsheet(robot_session: RobotSession) -> None:
    document = robot_session.get("dh").json()
    for row, joint in zip(read(robot_session.get("dh", CSV)), document["joints"], strict=True):
        assert int(row["joint"]) == joint["joint"]
        assert number(row["standard_uncertainty_d_mm"]) == joint["standard_uncertainty"]["d_mm"]
        assert number(row["a_mm"]) == joint["a_mm"]
        assert row["identifiable_d_mm"] == str(joint["identifiable"]["d_mm"]).lower()
    for row, group in zip(
        read(robot_session.get("dh", CSV, table="null_space")), document["null_space"], strict=True
    ):
        assert row["parameters"] == "; ".join(group["parameters"])
    frame = document["flange_camera"]
    (summary,) = read(robot_session.get("dh", CSV, table="summary"))
    assert [number(summary[f"flange_camera_position_{axis}_mm"]) for axis in "xyz"] == frame["position_mm"]
    assert number(summary["flange_camera_standard_uncertainty_x_mm"]) == frame["standard_uncertainty"]["x_mm"]
    assert summary["subject_robot_name"] == "KR5"


@pytest.mark.parametrize("analysis", ANALYSES)
def test_no_cell_is_a_formula_and_numbers_stay_numbers(robot_session: RobotSession, analysis: str) -> None:
    rows = read(robot_session.get(analysis, CSV, table="excluded"))
    row = next(r for r in rows if r["measurement_id"] == robot_session.measurement_ids[-1])
    assert (row["filename"], row["detail"]) == (f"'{FORMULA}", "'+1 hand in view")
    default = read(robot_session.get(analysis, CSV))
    assert default
    for cell in (cell for one in default for cell in one.values()):
        assert not cell.startswith(("=", "+", "@"))
        assert not cell.startswith("-") or float(cell) < 0.0


def test_a_table_has_a_tag_of_its_own(robot_session: RobotSession) -> None:
    api, address = robot_session.api, f"/v1/sessions/{robot_session.id}/repeatability"
    table, document = robot_session.get("repeatability", CSV), robot_session.get("repeatability")
    tags = {table.headers["ETag"].removeprefix("W/"), document.headers["ETag"].removeprefix("W/")}
    assert len(tags) == 2
    for response in (table, document):
        assert "Accept" in [name.strip() for name in response.headers["Vary"].split(",")]
    both = ", ".join(tags)
    for headers in (
        {"Accept": CSV, "If-None-Match": table.headers["ETag"]},
        {"Accept": CSV, "If-None-Match": both},
        {"If-None-Match": both},
    ):
        again = api.client.get(address, headers=headers)
        assert (again.status_code, again.content) == (304, b"")
    other = api.client.get(address, headers={"Accept": CSV, "If-None-Match": document.headers["ETag"]})
    assert other.status_code == 200
    preferred = api.client.get(address, headers={"Accept": "application/json, text/csv;q=0.5"})
    assert preferred.headers["content-type"] == "application/json"


def test_a_table_that_is_not_there_is_refused(robot_session: RobotSession) -> None:
    address = f"/v1/sessions/{robot_session.id}/repeatability"
    response = robot_session.api.client.get(address, params={"table": "groups.none"}, headers={"Accept": CSV})
    assert (response.status_code, response.json()["code"]) == (422, "unknown_table")
    assert "poses.outliers" in response.json()["advice"]
