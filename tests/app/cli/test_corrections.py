"""The commands that correct data, against a real server: what the advice says to do works."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.support.command_line import gridpose
from tests.support.service.service import ApiMaker, environment_of
from tests.support.service.service import gridpose as run_gridpose

JOINT = {"a_mm": 100.0, "alpha_deg": 90.0, "d_mm": 0.0}


def printed(api: Any, *arguments: str, code: int = 0) -> str:
    """Return what a command prints, as a process of its own."""
    done = run_gridpose(*arguments, **environment_of(api))
    assert done.returncode == code, done.stderr
    return done.stdout if code == 0 else done.stderr


@pytest.mark.slow
def test_a_wrong_target_is_corrected_as_the_failure_advises(serve_api: ApiMaker, board_png: bytes) -> None:
    with serve_api(workers=1, lent_workers=True) as api:
        session_id = api.make_session(api.make_target(columns=8, rows=5))
        failed = api.wait_for(api.put_image(session_id, board_png).json()["id"])
        assert failed["failure"]["code"] in ("target_mismatch", "target_not_found")
        assert "gridpose sessions change" in failed["failure"]["advice"]
        gridpose(api, "sessions", "change", session_id, "--target", "chessboard:9x6:25")
        corrected = api.wait_for(failed["id"])
        assert (corrected["status"], corrected["failure"]) == ("succeeded", None)
        (target_id,) = api.client.get(f"/v1/sessions/{session_id}").json()["target_ids"]
        assert corrected["target_id"] == target_id
        gridpose(api, "sessions", "reprocess", session_id, "--all")
        again = api.wait_for(failed["id"])
        assert again["calibration"] == corrected["calibration"]


def test_an_image_is_corrected_excluded_and_deleted(served: Any, grey_png: bytes) -> None:
    session_id = served.make_session(name="corrections")
    measurement_id = served.put_image(session_id, grey_png, filename="a.png").json()["id"]
    correct = ("measurements", "correct", measurement_id)
    gridpose(served, *correct, "--pose", "P7", "--cycle", "3", "--joint-angles", "1,-2.5")
    changed = served.measurement(measurement_id)
    assert (changed["pose_id"], changed["cycle"], changed["joint_angles_deg"]) == ("P7", 3, [1.0, -2.5])
    gridpose(served, *correct, "--cycle", "0", "--joint-angles", "")
    changed = served.measurement(measurement_id)
    assert (changed["cycle"], changed["joint_angles_deg"]) == (None, None)
    gridpose(served, "measurements", "exclude", measurement_id, "--reason", "moved")
    assert served.measurement(measurement_id)["excluded"]["reason"] == "moved"
    gridpose(served, "measurements", "include", measurement_id)
    assert served.measurement(measurement_id)["excluded"] is None
    gridpose(served, "measurements", "retry", measurement_id)
    gridpose(served, "measurements", "delete", measurement_id)
    gridpose(served, "measurements", "delete", measurement_id, code=1)
    gridpose(served, *correct, code=2)
    gridpose(served, *correct, "--joint-angles", "x", code=2)


@pytest.mark.slow
def test_lists_show_the_ids_that_other_commands_take(served: Any, grey_png: bytes) -> None:
    target = served.make_target(name="sheet [7]")
    session = served.make_session(target, name="lists")
    robot = served.client.post("/v1/robots", json={"name": "lister", "joints": [JOINT]}).json()["id"]
    measurement_id = served.put_image(session, grey_png, "P7", cycle=3, filename="a.png").json()["id"]
    gridpose(served, "measurements", "exclude", measurement_id, "--reason", "moved")
    listed = printed(served, "measurements", "list", "lists", "--pose", "P7")
    for cell in (measurement_id, "P7", "3", target, "queued", "excluded: moved", "a.png"):
        assert cell in listed
    shown = json.loads(printed(served, "measurements", "show", measurement_id))
    assert shown == served.measurement(measurement_id)
    assert json.loads(printed(served, "sessions", "show", "lists"))["id"] == session
    assert session in printed(served, "sessions", "list")
    targets = printed(served, "targets", "list")
    assert target in targets
    assert "sheet [7]" in targets
    assert robot in printed(served, "robots", "list")
    assert "target_in_use" in printed(served, "targets", "delete", target, code=1)


def test_sessions_targets_and_robots_are_shown_changed_and_deleted(served: Any) -> None:
    robot = served.client.post("/v1/robots", json={"name": "arm", "joints": [JOINT]}).json()["id"]
    target = served.make_target(name="sheet")
    session = served.make_session(target, name="shift 4")
    gridpose(served, "sessions", "change", "shift 4", "--robot", "arm", "--name", "shift 5")
    shown = served.client.get(f"/v1/sessions/{session}").json()
    assert (shown["name"], shown["robot_id"]) == ("shift 5", robot)
    refused = gridpose(served, "robots", "delete", "arm", code=1)
    assert "robot_in_use" in refused.stderr
    assert "gridpose sessions change" in refused.stderr
    gridpose(served, "sessions", "change", session, "--robot", "", "--target", "chessboard:7x5:10")
    gridpose(served, "robots", "delete", "arm")
    gridpose(served, "targets", "delete", target)
    gridpose(served, "sessions", "delete", session, code=1, stdin="n\n")
    assert "--yes" in gridpose(served, "sessions", "delete", session, code=2, stdin="").stderr
    gridpose(served, "sessions", "delete", session, stdin="y\n")
    assert served.client.get(f"/v1/sessions/{session}").status_code == 404
    gridpose(served, "sessions", "change", "none", code=2)
    gridpose(served, "sessions", "reprocess", "none", code=1)


def test_what_is_known_of_a_print_is_changed(served: Any, tmp_path: Path) -> None:
    target = served.make_target(name="plate")
    path = f"/v1/targets/{target}"
    uncertainty = {"pitch_x_mm": 0.001, "pitch_y_mm": 0.001}
    certificate = {
        "number": "4711",
        "pitch_x_mm": 25.01,
        "pitch_y_mm": 24.99,
        "standard_uncertainty": uncertainty,
    }
    file = tmp_path / "certificate.json"
    file.write_text(json.dumps(certificate), encoding="utf-8")
    change = ("targets", "change")
    gridpose(served, *change, "plate", "--name", "glass", "--print-kind", "glass", "--certificate", str(file))
    changed = served.client.get(path).json()
    assert (changed["name"], changed["print_kind"]) == ("glass", "glass")
    assert changed["certificate"]["pitch_x_mm"] == 25.01
    gridpose(served, *change, target, "--pitch-sigma-mm", "0.002")
    assert served.client.get(path).json()["pitch_standard_uncertainty_mm"] == 0.002
    entries = served.client.get("/v1/audit").json()["items"]
    assert ("update_target", [target]) in [(each["action"], each["object_ids"]) for each in entries]

    file.write_text(json.dumps({"certificate": None, "print_kind": "paper"}), encoding="utf-8")
    gridpose(served, *change, target, "--file", str(file), "--print-kind", "plate")
    changed = served.client.get(path).json()
    assert (changed["certificate"], changed["print_kind"]) == (None, "plate")
    assert "Nothing" in gridpose(served, *change, target, code=2).stderr
    assert "target_not_found" in gridpose(served, *change, "none", "--name", "x", code=1).stderr
    file.write_text(json.dumps({"pitch_mm": 26.0}), encoding="utf-8")
    assert "pitch_mm" in gridpose(served, *change, target, "--file", str(file), code=1).stderr
    rough = {**certificate, "standard_uncertainty": {**uncertainty, "pitch_x_mm": 3.0}}
    file.write_text(json.dumps(rough), encoding="utf-8")
    refused = gridpose(served, *change, target, "--certificate", str(file), code=1).stderr
    assert "--accept-implausible" in " ".join(refused.split())
    gridpose(served, *change, target, "--certificate", str(file), "--accept-implausible")
    assert served.client.get(path).json()["certificate"]["standard_uncertainty"]["pitch_x_mm"] == 3.0


def test_a_file_changes_lens_and_conditions_of_a_session(served: Any, tmp_path: Path) -> None:
    session = served.make_session(name="cold")
    file = tmp_path / "changes.yaml"
    file.write_text("conditions: {temperature_c: 21.5}\nname: none\n", encoding="utf-8")
    gridpose(served, "sessions", "change", "cold", "--file", str(file), "--name", "warm")
    changed = served.client.get(f"/v1/sessions/{session}").json()
    assert (changed["name"], changed["conditions"]["temperature_c"]) == ("warm", 21.5)


def test_unknown_fields_of_a_file_are_named_with_the_file(served: Any, tmp_path: Path) -> None:
    session = served.make_session()
    file = tmp_path / "changes.yaml"
    file.write_text("colour: red\nlens: {focal_length_mm: x, pixel_pitch_um: 2.0}\n", encoding="utf-8")
    for command in (("sessions", "change", session), ("robots", "create", "r", "--joint", "1:2:3")):
        refused = gridpose(served, *command, "--file", str(file), code=1).stderr
        assert all(text in refused for text in ("colour: ", "invalid_request", str(file)))
    assert served.client.get(f"/v1/sessions/{session}").json()["lens"] is None


def test_readings_are_deleted_by_pose_and_cycle_and_never_all_by_mistake(served: Any) -> None:
    session = served.make_session()
    address = f"/v1/sessions/{session}/measured-poses"
    readings = [{"pose_id": "P1", "cycle": k, "position_mm": [1.0, 2.0, 3.0]} for k in (1, 2, 3)]
    assert served.client.post(address, json=readings).status_code == 200
    delete = ("measured-poses", "delete", session)
    gridpose(served, *delete, code=2)
    gridpose(served, *delete, "--all", "--pose", "P1", code=2)
    gridpose(served, *delete, "--pose", "P1", "--cycle", "2")
    assert [each["cycle"] for each in served.client.get(address).json()["items"]] == [1, 3]
    gridpose(served, *delete, "--all")
    assert served.client.get(address).json()["items"] == []
