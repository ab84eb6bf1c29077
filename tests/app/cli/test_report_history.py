"""`gridpose report compare` and `gridpose robots history`: what they print, write and end with."""

from __future__ import annotations

import csv
from pathlib import Path
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner, Result

from app.analyses.history import summarise_reports
from app.cli.main import app
from tests.support.service.service import Api
from tests.support.sessions.filed_reports import content, store_filed

JOINT = {"a_mm": 100.0, "alpha_deg": 0.0, "d_mm": 0.0}


def run(api: Api | None, *arguments: str) -> Result:
    settings = {"COLUMNS": "250"}
    if api is not None:
        key = api.client.headers["authorization"].removeprefix("Bearer ")
        settings |= {"GRIDPOSE_URL": str(api.client.base_url), "GRIDPOSE_KEY": key}
    return CliRunner().invoke(app, list(arguments), env=settings)


def test_two_files_are_compared_without_a_service(tmp_path: Path) -> None:
    for number, rp_mm in ((1, 0.05), (2, 0.12)):
        (tmp_path / f"{number}.json").write_bytes(content(number, rp_mm=rp_mm))
    files = [str(tmp_path / "2.json"), str(tmp_path / "1.json")]
    ended = run(None, "report", "compare", *files)
    assert ended.exit_code == 0, ended.output
    assert ended.output.index("week 1") < ended.output.index("week 2")  # the earlier first, as given or not
    assert "× 2.4" in ended.output
    assert "3 of 3 figures are larger" in ended.output
    (tmp_path / "2.json").write_bytes(content(2, rp_mm=0.12, conditions={"load_kg": 1.0}))
    ended = run(None, "report", "compare", *files)
    assert ended.exit_code == 1
    assert "need not be the robot's" in " ".join(ended.output.split())
    (tmp_path / "2.json").write_bytes(b"thesis")
    ended = run(None, "report", "compare", *files)
    assert ended.exit_code == 2
    assert "2.json" in ended.output


def make_history(api: Api, name: str) -> str:
    robot = str(api.client.post("/v1/robots", json={"name": name, "joints": [JOINT]}).json()["id"])
    reports = [content(k, robot=robot, rp_mm=0.05 + 0.02 * (k > 9) + 0.001 * (k % 3)) for k in range(1, 19)]
    reports.append(content(18, robot=robot, report=f"rep_{98:026d}", rp_mm=0.071, name="=week 18"))
    store_filed(api, reports)
    while summarise_reports(api.installation.database):
        pass
    return robot


@pytest.mark.slow  # a process of the analyses loads what draws
def test_the_history_of_a_robot_is_read_from_its_service(served: Api, tmp_path: Path) -> None:
    robot = make_history(served, "<arm> & co")
    event = {"at": "2020-01-10T12:00:00Z", "note": "new belt"}
    assert served.client.post(f"/v1/robots/{robot}/events", json=event).status_code == 201
    table, drawing = (tmp_path / name for name in ("history.csv", "history.svg"))
    ended = run(served, "robots", "history", robot, "--csv", str(table), "--svg", str(drawing))
    assert ended.exit_code == 1, ended.output
    said = " ".join(ended.output.split())
    assert "went up" in said
    assert "Before it: new belt" in said
    title, drawn = ElementTree.parse(drawing).getroot()[:2]
    assert title.text == "History of <arm> & co"
    assert "noise floor all poses, test 1: No lasting change is shown." in str(drawn.text)
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert {row["figure"] for row in rows} == {"RP_l", "noise floor"}
    assert len(rows) == 2 * 18
    assert "'=week 18" in {row["session_name"] for row in rows}
    assert {row["alarm_mark"] for row in rows} == {"", "since", "shown"}
    ids = [f"rep_{k:026d}" for k in (1, 18)]
    compared = run(served, "report", "compare", *ids)
    assert compared.exit_code == 0, compared.output
    assert "each of 3 figures" in compared.output


def test_a_robot_without_reports_is_refused_with_advice(served: Api) -> None:
    robot = served.client.post("/v1/robots", json={"name": "new", "joints": [JOINT]}).json()["id"]
    ended = run(served, "robots", "history", robot)
    assert ended.exit_code == 2
    assert "gridpose report create" in ended.output
