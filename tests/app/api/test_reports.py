"""Stored reports over HTTP: ordered, made, immutable, in every form, signed, and verified."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import re
from collections.abc import Iterator
from typing import Any

import pytest
import sqlalchemy as sa

from app.cli.demo.session import joint_rows
from app.records.tables import Report, ReportForm
from app.reports.signature import check_file
from core.simulation import KR5_ARC
from tests.support.jobs.runners import compute
from tests.support.report_texts import page_text, technical_words
from tests.support.service.originals import original_path
from tests.support.service.service import Api, ApiMaker, assert_problem, wait_until
from tests.support.sessions.kinematics import measured, readings
from tests.support.sessions.stored_sessions import BOARD, board_fields, shoot, store_shots
from tests.support.sessions.tracked_robot import drawn_poses, send
from tests.support.sessions.tracked_robot import readings as tracked

pytestmark = pytest.mark.slow  # a process of the analyses loads the numerics
CONDITIONS = {"load_kg": 5.0, "operator": "R. Meier <b>#sys.inputs", "notes": "100 % speed"}
SIGNATORIES = [{"name": "Dr. *A* Schulz", "role": "head of laboratory"}, {"name": "=1+1", "role": None}]


@pytest.fixture(scope="module")
def running(open_api: ApiMaker) -> Iterator[Api]:
    with open_api() as api:
        yield api


@pytest.fixture(scope="module")
def made(running: Api) -> dict[str, Any]:
    """A repeatability report of stored grid points, whose originals were never there."""
    target_id = running.make_target(**board_fields(BOARD))
    session_id = running.make_session(target_id, name="Cell 4 & co", conditions=CONDITIONS)
    store_shots(running, session_id, shoot(poses=2, cycles=6), target_id)
    return finished(running, order(running, session_id, kind="repeatability", signatories=SIGNATORIES))


def order(api: Api, session_id: str, **body: Any) -> str:
    response = api.client.post(f"/v1/sessions/{session_id}/reports", json=body)
    assert response.status_code == 202, response.text
    assert response.headers["location"] == f"/v1/reports/{response.json()['id']}"
    return str(response.json()["id"])


def finished(api: Api, report_id: str) -> dict[str, Any]:
    def read() -> dict[str, Any]:
        document: dict[str, Any] = api.client.get(f"/v1/reports/{report_id}").json()
        return document

    wait_until(lambda: read()["status"] in ("succeeded", "failed"), 300.0, "the report is made")
    return read()


def form(api: Api, report: dict[str, Any], name: str) -> bytes:
    response = api.client.get(f"/v1/reports/{report['id']}.{name}")
    assert response.status_code == 200, response.text
    content: bytes = response.content
    return content


def test_every_form_is_stored_with_its_hash_and_signed(running: Api, made: dict[str, Any]) -> None:
    assert made["status"] == "succeeded", made["failure"]
    hashes = {one["form"]: one["sha256"] for one in made["forms"]}
    assert set(hashes) == {"json", "html", "pdf", "csv", "xml"}
    signature = form(running, made, "sig")
    for name, sha256 in hashes.items():
        content = form(running, made, name)
        assert hashlib.sha256(content).hexdigest() == sha256
        found = check_file(content, signature)
        assert found.is_valid
        assert (found.form, found.fingerprint) == (name, made["signing_key"])
        assert not check_file(content + b" ", signature).is_valid
    forged = json.loads(signature)
    forged["manifest"]["made_at"] = "2020-01-01T00:00:00+00:00"
    assert not check_file(form(running, made, "pdf"), json.dumps(forged).encode()).is_valid
    assert len(base64.b64decode(forged["signature"])) == 64


def test_the_forms_hold_the_same_figures_and_no_markup_of_users(running: Api, made: dict[str, Any]) -> None:
    document = json.loads(form(running, made, "json"))
    pose = document["analyses"]["repeatability"]["poses"][0]
    shown = form(running, made, "csv").decode().splitlines()
    value = repr(pose["repeatability"]["rp_l_mm"])
    assert f"repeatability,poses[P1].repeatability.rp_l_mm,{value},mm" in shown
    page = form(running, made, "html").decode()
    assert "<b>#sys" not in page
    assert "Measuring instrument" in page
    assert "not stated; measurements arrived 2" in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert len(document["inputs"]["images"]) == 12
    assert form(running, made, "pdf").startswith(b"%PDF-")
    assert not technical_words({name: form(running, made, name) for name in ("html", "xml")}, document)
    certificate = form(running, made, "xml").decode()
    assert f"<si:value>{value}</si:value>" in certificate
    assert "R. Meier &lt;b&gt;#sys" in certificate


def test_drawings_of_many_poses_take_several_pages(running: Api) -> None:
    session_id = running.make_session(running.make_target(**board_fields(BOARD)))
    send(running, session_id, tracked(drawn_poses(3, 12), cycles=20))
    made = finished(running, order(running, session_id, kind="repeatability"))
    page = form(running, made, "html").decode()
    captions = re.findall(r"<figcaption[^>]*>(.*?)</figcaption>", page)
    numbers = [re.search(r"(?:Page (\d of \d)\.)?$", one)[1] for one in captions]  # type: ignore[index]
    assert numbers == ["1 of 3", "2 of 3", "3 of 3", "1 of 2", "2 of 2", "1 of 2", "2 of 2"]
    drawn = [base64.b64decode(one).decode() for one in re.findall(r"image/svg\+xml;base64,([\w+/=]+)", page)]
    named = [re.findall(r"^P\d+(?=:)", re.search(r"<desc>(.*?)</desc>", one, re.S)[1], re.M) for one in drawn]  # type: ignore[index]
    for pages in (named[:3], named[3:5], named[5:]):
        assert [name for one in pages for name in one] == [f"P{n}" for n in range(1, 13)]


def test_a_report_on_kinematics_is_in_words(running: Api) -> None:
    robot = {"name": "KR 5 arc, cell 4", "joints": joint_rows(KR5_ARC)}
    robot_id = running.client.post("/v1/robots", json=robot).json()["id"]
    session_id = running.make_session(running.make_target(**board_fields(BOARD)), robot_id=robot_id)
    stored = running.client.post(f"/v1/sessions/{session_id}/measured-poses", json=readings(measured()[1]))
    assert stored.is_success, stored.text
    found = finished(running, order(running, session_id, kind="kinematics"))
    assert found["status"] == "succeeded", found["failure"]
    forms = {name: form(running, found, name) for name in ("html", "xml")}
    assert not technical_words(forms, json.loads(form(running, found, "json")))
    assert "Denavit-Hartenberg, classic" in page_text(forms["html"])


def test_a_session_in_which_nothing_was_repeated_gives_a_report_that_begins_with_that(running: Api) -> None:
    target_id = running.make_target(**board_fields(BOARD))
    session_id = running.make_session(target_id, name="Once")
    shots = [dataclasses.replace(shot, cycle=None) for shot in shoot(poses=4, cycles=1)]
    store_shots(running, session_id, shots, target_id)
    once = finished(running, order(running, session_id, kind="repeatability"))
    assert once["status"] == "succeeded", once["failure"]
    page = page_text(form(running, once, "html"))
    assert page.index("Nothing was repeated") < page.index("Conditions")
    assert not technical_words({"html": form(running, once, "html")}, json.loads(form(running, once, "json")))


def test_a_finished_report_cannot_be_changed_by_anyone(running: Api, made: dict[str, Any]) -> None:
    for table, column in ((Report, "title"), (ReportForm, "sha256")):
        which = Report.id == made["id"] if table is Report else ReportForm.report_id == made["id"]
        for statement in (sa.update(table).where(which).values({column: "0"}), sa.delete(table).where(which)):
            with (
                pytest.raises(sa.exc.DatabaseError),
                running.installation.database.engine.begin() as connection,
            ):
                connection.execute(statement)
    assert finished(running, made["id"]) == made


def test_a_report_whose_originals_are_lost_does_not_verify_and_names_them(
    running: Api, made: dict[str, Any]
) -> None:
    path = f"/v1/reports/{made['id']}/verify"
    stored = running.client.get(path, params={"originals": "false"}).json()
    assert stored["agrees"]
    assert stored["figures_equal"] == stored["figures"] > 200
    whole = running.client.get(path).json()
    assert not whole["agrees"]
    assert {one["detail"] for one in whole["changed_inputs"]} == {"original missing"}
    assert whole["changed_input_count"] == 12


def test_a_report_verifies_from_its_originals_until_one_changes(running: Api, board_png: bytes) -> None:
    session_id = running.make_session()
    for pose in ("P1", "P2"):
        assert running.put_image(session_id, board_png, pose, cycle=1).status_code == 202
    compute(running)
    report = finished(running, order(running, session_id, kind="camera", title="Lens", paper="letter"))
    assert report["status"] == "succeeded", report["failure"]
    path = f"/v1/reports/{report['id']}/verify"
    found = running.client.get(path).json()
    assert found["agrees"], found
    assert (found["originals"]["measured"], found["originals"]["identical"]) == (2, 2)
    assert found["core_version_then"] == found["core_version_now"]
    measurement = running.measurements(session_id)[0]
    original = original_path(running.installation, measurement["sha256"])
    original.write_bytes(board_png[:-1] + b"!")
    found = running.client.get(path).json()
    assert not found["agrees"]
    assert found["changed_inputs"][0] == {
        "noun": "image",
        "name": measurement["id"],
        "detail": "original changed",
    }
    original.write_bytes(board_png)
    excluded = {"excluded": {"reason": "A hand in front."}}
    assert running.client.patch(f"/v1/measurements/{measurement['id']}", json=excluded).status_code == 200
    found = running.client.get(path).json()
    assert (found["agrees"], found["is_current"], found["recomputed_from"]) == (True, False, "report")
    assert found["figures_equal"] == found["figures"] > 0
    change = {"noun": "image", "name": measurement["id"], "detail": "excluded: A hand in front."}
    assert found["changed_inputs"] == [change]
    assert running.client.delete(f"/v1/sessions/{session_id}").status_code == 204
    assert form(running, report, "pdf").startswith(b"%PDF-")
    found = running.client.get(path).json()
    assert (found["agrees"], found["figures"], found["recomputed_from"]) == (False, 0, "nothing")
    deleted = [{"noun": "session", "name": session_id, "detail": "deleted"}]
    assert found["changed_inputs"] == found["unavailable_inputs"] == deleted
    listed = running.client.get("/v1/reports", params={"session_id": session_id}).json()["items"]
    assert [one["id"] for one in listed] == [report["id"]]


def test_a_report_is_computed_from_what_it_was_made_from_until_grid_points_are_deleted(running: Api) -> None:
    target_id = running.make_target(**board_fields(BOARD))
    robot = {"name": "KR 5 arc", "joints": joint_rows(KR5_ARC), "datasheet_repeatability_mm": 0.1}
    robot_id = running.client.post("/v1/robots", json=robot).json()["id"]
    session_id = running.make_session(target_id, robot_id=robot_id, conditions=CONDITIONS)
    shots = shoot(poses=2, cycles=4)
    ids = store_shots(running, session_id, shots[:7], target_id)
    report = finished(running, order(running, session_id, kind="repeatability"))

    def verified() -> dict[str, Any]:
        path = f"/v1/reports/{report['id']}/verify"
        found: dict[str, Any] = running.client.get(path, params={"originals": "false"}).json()
        return found

    def change(path: str, **body: Any) -> None:
        response = running.client.patch(path, json=body)
        assert response.status_code == 200, response.text

    assert verified()["is_current"]
    change(f"/v1/measurements/{ids[0]}", pose_id="P2", cycle=9)
    change(f"/v1/measurements/{ids[1]}", excluded={"reason": "hand in view"})
    change(f"/v1/measurements/{ids[2]}", focus_group="far", joint_angles_deg=[1.0] * 6)
    change(f"/v1/robots/{robot_id}", datasheet_repeatability_mm=0.001)
    change(f"/v1/sessions/{session_id}", robot_id=None, lens={"focal_length_mm": 8.0, "pixel_pitch_um": 5.0})
    store_shots(running, session_id, shots[7:], target_id)
    found = verified()
    assert (found["agrees"], found["is_current"], found["recomputed_from"]) == (True, False, "report"), found
    assert found["figures_equal"] == found["figures"] > 100
    changes = {one["name"]: one["detail"] for one in found["changed_inputs"]}
    assert changes[ids[0]] == "moved from P1 cycle 1 to P2 cycle 9"
    assert changes[ids[1]] == "excluded: hand in view"
    assert changes[robot_id] == "removed from the session"
    assert running.client.delete(f"/v1/measurements/{ids[3]}").status_code == 204
    found = verified()
    assert (found["agrees"], found["figures"], found["recomputed_from"]) == (False, 0, "nothing")
    assert found["unavailable_inputs"] == [{"noun": "image", "name": ids[3], "detail": "deleted"}]


def test_what_cannot_be_reported_fails_with_the_reason_of_the_analysis(running: Api) -> None:
    session_id = running.make_session()
    report = finished(running, order(running, session_id, kind="kinematics"))
    assert report["status"] == "failed"
    assert report["failure"]["code"]
    assert report["forms"] == []
    assert_problem(running.client.get(f"/v1/reports/{report['id']}.pdf"), 409, report["failure"]["code"])
    assert_problem(running.client.get(f"/v1/reports/{report['id']}/verify"), 409, report["failure"]["code"])


def test_keys_see_only_reports_of_their_sessions(running: Api, made: dict[str, Any]) -> None:
    other = running.make_session()
    key = running.key("upload", session_ids=[other])
    for ending in ("", ".pdf", ".sig", "/verify"):
        response = running.client.get(f"/v1/reports/{made['id']}{ending}", headers=key)
        assert_problem(response, 404, "report_not_found")
    assert running.client.get("/v1/reports", headers=key).json()["items"] == []
    assert_problem(
        running.client.post(
            f"/v1/sessions/{other}/reports", json={"kind": "camera"}, headers=running.key("read")
        ),
        403,
    )


def test_a_template_with_errors_fails_the_report_with_file_and_field(
    running: Api, made: dict[str, Any]
) -> None:
    folder = running.installation.settings.data_dir / "templates"
    folder.mkdir()
    (folder / "report.toml").write_text('organisation = "Example"\ncolour = "red"\n', encoding="utf-8")
    failed = finished(running, order(running, made["session_id"], kind="repeatability"))
    assert failed["failure"]["code"] == "template_invalid"
    assert "colour" in failed["failure"]["detail"]
    (folder / "report.toml").write_text(
        'organisation = "Example"\n[fields]\n"Order" = "4711"\n', encoding="utf-8"
    )
    (folder / "logo.svg").write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 9 9"><path d="M0 0h9v9z"/></svg>',
        encoding="utf-8",
    )
    report = finished(running, order(running, made["session_id"], kind="session"))
    assert report["status"] == "succeeded", report["failure"]
    assert "4711" in form(running, report, "html").decode()
    # A whole session is no item that a certificate could be of.
    assert_problem(running.client.get(f"/v1/reports/{report['id']}.xml"), 404, "report_form_not_found")
