"""Where the robot is off its data sheet, over HTTP; and the drawing of what the poses cannot determine."""

from __future__ import annotations

import csv
import io
import re
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from app.api.schemas.analyses import KinematicErrorAnalysis
from app.cli.demo.session import joint_rows
from app.reports.forms import symbols
from core.simulation.arm import KR5_ARC, KR5_ARC_LIMITS
from tests.support.service.signed_in import signed_in
from tests.support.sessions.kinematics import make_robot, readings
from tests.support.sessions.stored_sessions import body, new_session, problem
from tests.support.sessions.tracked_robot import send
from tests.support.simulation.robots.real_arms import angles_within_limits, measured, real_arm

DESCRIPTION = "{http://www.w3.org/2000/svg}desc"
POSES = 36


@pytest.fixture(scope="module")
def session(api: Any) -> str:
    rng = np.random.default_rng(31)
    robot = make_robot(api)
    joints = [
        {**row, "minimum_deg": low, "maximum_deg": high}
        for row, (low, high) in zip(joint_rows(KR5_ARC), np.degrees(KR5_ARC_LIMITS).tolist(), strict=True)
    ]
    assert api.client.patch(f"/v1/robots/{robot}", json={"joints": joints}).status_code == 200
    made: str = new_session(api, robot_id=robot)
    send(api, made, readings(measured(real_arm(rng, perfect=True), angles_within_limits(rng, POSES), rng)))
    return made


def ask(api: Any, session: str, path: str = "error-map", **options: Any) -> Any:
    return api.client.get(f"/v1/sessions/{session}/dh/{path}?source=measured_poses", **options)


def test_the_map_has_cells_and_the_largest_error_and_is_a_table(api: Any, session: str) -> None:
    found = body(ask(api, session))
    KinematicErrorAnalysis.model_validate(found, extra="forbid")
    cells = found["error_map"]["error_cells"]
    assert sum(cell["measured_configurations"] for cell in cells) == found["measured_configurations"]
    assert POSES - 2 <= found["measured_configurations"] <= POSES
    assert {cell["extrapolated"] for cell in cells} == {True, False}
    assert found["limits_stated"] == [True] * 6
    worst = found["largest_error_place"]
    assert worst["error_mm"] == pytest.approx(float(np.linalg.norm(worst["error_vector_mm"])), rel=1e-3)
    assert worst["error_mm"] >= found["median_error_mm"] > found["median_uncertainty_mm"] > 0.0
    table = ask(api, session, headers={"Accept": "text/csv"})
    assert table.status_code == 200, table.text
    assert len(table.text.splitlines()) == 1 + len(cells)


@pytest.mark.parametrize("path", ["error-map.svg", "identifiability.svg"])
def test_the_drawings_say_in_words_what_they_show(api: Any, session: str, path: str) -> None:
    response = ask(api, session, path)
    assert response.status_code == 200, response.text
    drawn = ElementTree.fromstring(response.content)
    title = str(drawn.findtext(DESCRIPTION.replace("desc", "title")))
    assert re.search(r" · robot .+ · session of \d{4}-\d{2}-\d{2}$", title)
    said = str(drawn.findtext(DESCRIPTION))
    if path == "error-map.svg":
        assert "largest there" in said
        assert "extrapolated" in said
    else:
        groups = body(_dh(api, session))["null_space"]
        assert groups
        for group in groups:
            assert symbols(group["sentence"]) in said
        assert "theta" not in said, "parameters are written as the table has them"


def _dh(api: Any, session: str) -> Any:
    return api.client.get(f"/v1/sessions/{session}/dh?source=measured_poses")


def test_the_identified_robot_is_downloaded_from_its_page(api: Any, session: str) -> None:
    here = f"/ui/sessions/{session}/robot"
    page = api.client.get(f"{here}?source=measured_poses&compute=1", headers=signed_in(api))
    assert page.status_code == 200, page.text
    links = dict.fromkeys(re.findall(rf'href="({here}/files/[^"]+)"', page.text))
    files = {
        link.rpartition("/")[2].partition("?")[0]: api.client.get(link, headers=signed_in(api))
        for link in links
    }
    assert {"robot.urdf", "robot.csv", "robot.yaml"} <= set(files)
    assert all(one.status_code == 200 for one in files.values())
    assert len(ElementTree.fromstring(files["robot.urdf"].content).findall("joint")) >= 6
    rows = list(csv.DictReader(io.StringIO(files["robot.csv"].text)))
    alone = api.client.get(f"/v1/sessions/{session}/dh?source=measured_poses&model=dh").json()
    assert [float(row["a_mm"]) for row in rows] == [joint["a_mm"] for joint in alone["joints"]]
    missing = api.client.get(f"{here}/files/robot.exe?source=measured_poses", headers=signed_in(api))
    assert missing.status_code == 404


def test_without_a_robot_there_is_no_data_sheet_to_compare_with(api: Any) -> None:
    alone = new_session(api)
    rng = np.random.default_rng(32)
    send(api, alone, readings(measured(real_arm(rng, perfect=True), angles_within_limits(rng, 5), rng)))
    assert problem(ask(api, alone), 409, "nominal_robot_missing")["advice"]
    assert api.client.get("/v1/sessions/ses_nothing/dh/error-map").status_code == 404
