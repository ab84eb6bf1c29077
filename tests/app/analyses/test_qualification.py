"""Known lengths against what a session measured, over HTTP and with `gridpose qualify`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa
from typer.testing import CliRunner, Result

from app.api.schemas.analyses import QualificationAnalysis
from app.cli.main import app
from app.records.ids import new_id
from app.records.tables import Qualification
from tests.support.service.service import ApiMaker, assert_problem
from tests.support.sessions.kinematics import make_robot
from tests.support.sessions.stored_sessions import new_session
from tests.support.sessions.tracked_robot import drawn_poses, readings, send

CYCLES = 12


@pytest.fixture(scope="module")
def served(serve_api: ApiMaker) -> Iterator[Any]:
    with serve_api() as api:
        yield api


@pytest.fixture(scope="module")
def measured(served: Any) -> tuple[str, list[dict[str, Any]]]:
    return measure(served)


def measure(api: Any, **fields: Any) -> tuple[str, list[dict[str, Any]]]:
    """Return a session of four poses that an instrument measured, and the lengths that it measured from P1 on."""
    session = new_session(api, **fields)
    sent = readings(drawn_poses(4, 4), cycles=CYCLES)
    send(api, session, sent)
    places = np.array([one["position_mm"] for one in sent]).reshape(CYCLES, 4, 3).mean(axis=0)
    lengths = [
        {
            "from_pose_id": "P1",
            "to_pose_id": f"P{k + 1}",
            "length_mm": float(np.linalg.norm(places[k] - places[0])),
            "standard_uncertainty_mm": 0.002,
        }
        for k in (1, 2, 3)
    ]
    return session, lengths


def ask(api: Any, session: str, lengths: list[dict[str, Any]], **fields: Any) -> Any:
    body = {"lengths": lengths, "source": "measured_poses", **fields}
    return api.client.post(f"/v1/sessions/{session}/qualification", json=body)


@pytest.mark.slow
def test_true_lengths_are_kept_and_wrong_ones_are_not(served: Any, measured: Any) -> None:
    session, lengths = measured
    found = ask(served, session, lengths, maximum_permissible_error_mm=0.5).json()
    QualificationAnalysis.model_validate(found, extra="forbid")
    assert found["decision"] == "pass"
    assert [one["to_pose_id"] for one in found["lengths"]] == ["P2", "P3", "P4"]
    for one in found["lengths"]:
        assert one["error_mm"] == pytest.approx(0.0, abs=1e-6)
        low, high = one["interval_mm"]
        assert low < 0.0 < high
        assert one["standard_uncertainty_mm"] > one["length_standard_uncertainty_mm"]
    longer = [{**one, "length_mm": one["length_mm"] * 1.01} for one in lengths]
    found = ask(served, session, longer, maximum_permissible_error_mm=0.5).json()
    assert found["decision"] == "fail"
    assert found["scale_ppm"] == pytest.approx(-9900.0, rel=0.05)
    assert ask(served, session, longer).json()["decision"] is None


def test_what_was_not_measured_is_named(served: Any, measured: Any) -> None:
    session, lengths = measured
    problem = assert_problem(
        ask(served, session, [{**lengths[0], "to_pose_id": "P9"}]), 409, "invalid_argument"
    )
    assert "P9" in problem["detail"]
    assert problem["advice"]
    assert_problem(ask(served, session, []), 422, "invalid_request")
    assert_problem(ask(served, session, [{**lengths[0], "length_mm": 0.0}]), 422, "invalid_request")
    assert_problem(ask(served, served.make_session(), lengths), 409, "measured_poses_missing")


def qualify(api: Any, *arguments: str, code: int = 0) -> Result:
    key = api.client.headers["authorization"].removeprefix("Bearer ")
    settings = {"GRIDPOSE_URL": str(api.client.base_url), "GRIDPOSE_KEY": key}
    done = CliRunner().invoke(app, ["qualify", *arguments, "--source", "measured_poses"], env=settings)
    assert done.exit_code == code, done.output
    return done


def test_a_record_is_written_once(served: Any, measured: Any, tmp_path: Path) -> None:
    session, lengths = measured
    table = tmp_path / "lengths.csv"
    names = list(lengths[0])
    rows = [",".join(names), *(",".join(str(one[name]) for name in names) for one in lengths)]
    table.write_text("\n".join(rows), encoding="utf-8")
    record = tmp_path / "record.json"
    options = ("--maximum-error-mm", "0.5", "--valid-days", "30", "-o", str(record))
    assert "pass" in qualify(served, session, str(table), *options).stdout
    written = json.loads(record.read_text(encoding="utf-8"))
    assert served.client.get(f"/v1/qualifications/{written['id']}").json() == written
    assert written["due_at"] > written["made_at"]
    assert written["decision"] == "pass"
    qualify(served, session, str(table), *options, code=2)
    assert json.loads(record.read_text(encoding="utf-8")) == written
    assert (
        "inconclusive" in qualify(served, session, str(table), "--maximum-error-mm", "0.001", code=3).stdout
    )


def record(api: Any, session: str, lengths: list[dict[str, Any]], **fields: Any) -> dict[str, Any]:
    body = {"lengths": lengths, "source": "measured_poses", **fields}
    response = api.client.post(f"/v1/sessions/{session}/qualifications", json=body)
    assert response.status_code == 201, response.text
    assert response.headers["location"] == f"/v1/qualifications/{response.json()['id']}"
    found: dict[str, Any] = response.json()
    return found


def cited(api: Any, session: str) -> Any:
    url = f"/v1/sessions/{session}/repeatability"
    return api.client.get(url, params={"source": "measured_poses"}).json()["subject"]["qualification"]


def test_what_is_measured_afterwards_cites_the_latest_record(api: Any) -> None:
    robot = make_robot(api)
    session, lengths = measure(api, robot_id=robot)
    other, _ = measure(api)
    assert cited(api, session) is None
    first = record(api, other, lengths)  # of the installation: it holds for a robot without its own
    assert (first["robot_id"], first["decision"], first["control_scale_ppm"]) == (None, None, None)
    assert cited(api, session)["id"] == cited(api, other)["id"] == first["id"]
    own = record(api, session, lengths, maximum_permissible_error_mm=0.5, valid_days=30, camera_name="C-7")
    assert (own["robot_id"], own["camera_name"], own["decision"]) == (robot, "C-7", "pass")
    assert own["analysis"]["lengths"][0]["to_pose_id"] == "P2"
    found = cited(api, session)
    assert (found["id"], found["decision"]) == (own["id"], "pass")
    made, due = (datetime.fromisoformat(found[name]) for name in ("made_at", "due_at"))
    assert due - made == timedelta(days=30)
    assert cited(api, other)["id"] == first["id"]
    listed = api.client.get("/v1/qualifications").json()["items"]
    assert [one["id"] for one in listed] == [first["id"], own["id"]]
    assert "analysis" not in listed[0]
    of_robot = api.client.get("/v1/qualifications", params={"robot_id": robot}).json()["items"]
    assert [one["id"] for one in of_robot] == [own["id"]]
    entries = api.client.get("/v1/audit", params={"object_id": own["id"]}).json()["items"]
    assert [entry["action"] for entry in entries] == ["create_qualification_record"]
    assert_problem(api.client.get(f"/v1/qualifications/qua_{'0' * 26}"), 404, "qualification_not_found")
    with pytest.raises(sa.exc.DBAPIError), api.installation.database.write() as records:
        records.execute(sa.update(Qualification).values(decision="pass"))


def test_what_another_source_measured_is_not_cited(api: Any) -> None:
    robot = make_robot(api)
    session, lengths = measure(api, robot_id=robot)
    made = record(api, session, lengths)
    with api.installation.database.write() as records:
        row = records.get(Qualification, made["id"])
        columns = {column.key: getattr(row, column.key) for column in sa.inspect(Qualification).columns}
        of_images = {**columns, "id": new_id("qua"), "analysis": {**row.analysis, "source": "images"}}
        records.execute(sa.insert(Qualification).values(of_images))
    assert cited(api, session)["id"] == made["id"]


def test_a_record_is_compared_with_the_earlier_ones_of_its_set_up(api: Any) -> None:
    session, lengths = measure(api)
    for k in range(5):
        longer = [{**one, "length_mm": one["length_mm"] * (1.0 + 1e-5 * (k % 2))} for one in lengths]
        assert record(api, session, longer, camera_name="charted")["control_scale_ppm"] is None
    sixth = record(api, session, lengths, camera_name="charted")
    assert sixth["control_probing_scatter_mm"]["in_control"]  # the same in all: limits without width
    usual = sixth["control_scale_ppm"]
    assert usual["records"] == 5
    assert usual["in_control"]
    wrong = [{**one, "length_mm": one["length_mm"] * 1.001} for one in lengths]
    found = record(api, session, wrong, camera_name="charted")
    assert not found["control_scale_ppm"]["in_control"]
    assert found["control_scale_ppm"]["high"] - found["control_scale_ppm"]["low"] < 200.0
    assert record(api, session, lengths, camera_name="another")["control_scale_ppm"] is None


def test_a_damaged_record_is_named(api: Any) -> None:
    session, lengths = measure(api)
    made = record(api, session, lengths)
    with api.installation.database.write() as records:
        records.execute(sa.text("DROP TRIGGER qualifications_no_update"))
        damage = sa.text("UPDATE qualifications SET analysis = '{half' WHERE id = :id")
        records.execute(damage, {"id": made["id"]})
    assert_problem(api.client.get(f"/v1/qualifications/{made['id']}"), 409, "row_unreadable")
    listed = api.client.get("/v1/qualifications").json()["items"]
    assert made["id"] in [one["id"] for one in listed]


@pytest.mark.parametrize(
    "text",
    [
        "from_pose_id,to_pose_id,length_mm\nP1,P2,3",
        "from_pose_id,to_pose_id,length_mm,standard_uncertainty_mm\nP1,P2,a,1",
    ],
)
def test_a_table_that_does_not_hold_lengths_is_refused(
    served: Any, measured: Any, tmp_path: Path, text: str
) -> None:
    file = tmp_path / "lengths.csv"
    file.write_text(text, encoding="utf-8")
    assert "line 2" in qualify(served, measured[0], str(file), code=2).stderr
