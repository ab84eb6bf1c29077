"""The dashboard in a real browser: the main task of each page, by mouse and by keyboard."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from app.blobs.local import LocalBlobs
from tests.web.conftest import Cell, new_key, nothing, violations

pytestmark = pytest.mark.slow
Open = Callable[..., Any]


def test_a_new_user_gets_from_a_target_to_a_table(cell: Cell, open_page: Open, tmp_path: Path) -> None:
    """Design a board, create a session, drop images, watch them come, read why one was refused, read the table."""
    page = open_page("/ui/targets/new")
    page.fill("#name", "Board of the new user")
    page.fill("#columns", "9")
    page.fill("#pitch", "30")
    page.wait_for_selector("#preview[data-shown*='pitch_mm=30']")
    kind = page.evaluate(
        "fetch(document.getElementById('print').href).then(a => a.headers.get('content-type'))"
    )
    assert kind == "application/pdf"
    page.click("#store")
    page.wait_for_url("**/ui/targets/tgt_*")
    page.click("text=New session with this target")
    page.fill("#name", "Dropped")
    page.select_option("#robot", label="KR 5 arc")
    page.fill("#temperature", "21,5")  # a comma is a decimal sign to many
    page.click("text=Create")
    page.wait_for_url("**/upload")
    folder = tmp_path / "P1"
    folder.mkdir()
    for image in cell.images[:4]:
        (folder / f"{image.pose_id}_{image.cycle}.png").write_bytes(image.data)
    (folder / "P2_1.png").write_bytes(nothing(1))
    (folder / "notes.txt").write_text("no image")
    page.set_input_files("#files", sorted(folder.iterdir()))
    assert page.inner_text("#plan-title") == "5 images at 2 poses"
    assert "1 file is no image" in page.inner_text("#report")
    page.click("#send")
    page.wait_for_selector("text=See the images")
    assert page.inner_text("#report").startswith("5 sent, 0 were here already, 0 refused")
    page.click("#clear")
    page.set_input_files("#files", sorted(folder.glob("*.png")))  # again: nothing is sent twice
    page.click("#send")
    page.wait_for_selector("#report:has-text('5 were here already')")
    page.click("text=See the images")
    page.wait_for_selector("text=4 measured")
    page.wait_for_selector(".tile.bad")
    page.click(".tile.bad a")
    page.wait_for_selector("text=Why:")
    assert "What to do:" in page.inner_text("main")
    page.click("nav.tabs >> text=Repeatability")
    page.wait_for_selector("table.iso tbody tr")
    assert page.inner_text("table.iso tbody tr:first-child td:nth-child(2)") == "4"
    assert not page.troubles


def test_a_full_disk_stops_sending_and_what_is_left_is_sent_later(
    cell: Cell, open_page: Open, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session_id = cell.api.make_session(cell.target_id, name="Full disk")
    for number in range(6):
        (tmp_path / f"P1_{number + 1}.png").write_bytes(nothing(100 + number))
    page = open_page(f"/ui/sessions/{session_id}/upload")
    page.set_input_files("#files", sorted(tmp_path.iterdir()))
    with monkeypatch.context() as full:
        full.setattr(LocalBlobs, "free_bytes", lambda _: 0)
        page.click("#send")
        page.wait_for_selector("#report:has-text('Stopped')")
        page.wait_for_selector("#pause", state="hidden")  # what was under way has ended, too
    report = page.inner_text("#report")
    assert report.startswith("0 sent, 0 were here already, 0 refused, 6 to go. Stopped: ")
    assert "space" in report
    assert page.inner_text("#send") == "Send 6 images"
    assert re.match("to send again: .*space", page.inner_text("#rows tr:first-child td:last-child"))
    page.evaluate("scrollTo(0, 0)")  # links that the head covers in part count as small
    assert violations(page) == []
    page.click("#send")
    page.wait_for_selector("#report:has-text('6 sent')")
    assert page.inner_text("#rows tr:first-child td:last-child") == "sent"
    # The browser itself writes refused requests to its console.
    assert [one for one in page.troubles if "507" not in one] == []


def test_images_dropped_onto_the_page_are_planned(cell: Cell, open_page: Open) -> None:
    page = open_page(f"/ui/sessions/{cell.session_id}/upload")
    page.evaluate(
        """() => {
          const data = new DataTransfer();
          for (const name of ["A_1.png", "A_2.png", "B-c10.png", "readme.md"]) data.items.add(new File(["x"], name));
          document.getElementById("drop").dispatchEvent(new DragEvent("drop", {dataTransfer: data, bubbles: true}));
        }"""
    )
    page.wait_for_selector("#plan:not([hidden])")
    rows = [re.split(r"\t", row) for row in page.inner_text("#rows").splitlines()]
    assert [row[:3] for row in rows] == [
        ["A_1.png", "A", "1"],
        ["A_2.png", "A", "2"],
        ["B-c10.png", "B", "10"],
    ]
    assert not page.is_visible("#camera-only")
    page.select_option("[name=pattern]", "name")
    assert "no repeatability" in page.inner_text("#camera-only")
    same = page.evaluate("gridpose.plainSha256(new TextEncoder().encode('abc'))")
    assert same == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"  # FIPS 180-4, B.1
    assert not page.troubles


def test_an_exclusion_by_keyboard_alone_changes_the_table(cell: Cell, open_page: Open) -> None:
    api, session_id = cell.api, cell.session_id
    page = open_page(f"/ui/sessions/{session_id}")
    page.wait_for_selector("#selection")
    first = page.locator(".tile .pick").last
    first.focus()
    page.keyboard.press("Space")
    assert page.inner_text("#selected") == "1 selected"
    page.locator("[data-act=exclude]").focus()
    page.keyboard.press("Enter")
    page.keyboard.type("a hand in front of the board")
    page.keyboard.press("Enter")
    page.wait_for_selector(".tile.mute")
    excluded = [one for one in api.measurements(session_id) if one["excluded"]]
    assert [one["excluded"]["reason"] for one in excluded] == ["a hand in front of the board"]
    page.goto(f"/ui/sessions/{session_id}/repeatability")
    assert page.inner_text("table.iso tbody tr:first-child td:nth-child(2)") == "9"
    page.goto(f"/ui/measurements/{excluded[0]['id']}")
    page.click("text=Include again")
    page.wait_for_selector(".corrections >> text=Exclude, because")
    assert not api.measurement(excluded[0]["id"])["excluded"]
    page.fill("#c-pose", "P1 with a blank")
    page.click(".corrections >> text=Save")
    page.wait_for_selector(".field-problem:has-text('Pose: may hold the letters')")
    page.troubles.clear()  # the browser logs the refusal that was asked for
    page.keyboard.press("Escape")
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("ArrowRight")
    page.wait_for_url(lambda url: excluded[0]["id"] not in url)
    assert not page.troubles


def test_the_overlay_zooms_and_its_layers_switch(cell: Cell, open_page: Open) -> None:
    page = open_page(f"/ui/measurements/{cell.measurement_ids[0]}")
    page.wait_for_selector("#viewer[data-ready=yes]")

    def drawn() -> str:
        return str(page.evaluate("document.querySelector('.stage canvas').toDataURL()"))

    seen = {drawn()}
    for act in (
        lambda: page.click("[data-zoom=in]"),
        lambda: page.uncheck("[data-layer=residuals]"),
        lambda: page.uncheck("[data-layer=points]"),
        lambda: page.locator(".stage canvas").press("ArrowLeft"),
    ):
        act()
        assert drawn() not in seen
        seen.add(drawn())
    page.goto(f"/ui/measurements/{cell.refused_id}")
    page.wait_for_selector("#viewer[data-ready=yes]")  # refused images are drawn, too
    assert not page.troubles


def test_the_scatter_turns_and_shows_its_numbers(cell: Cell, open_page: Open) -> None:
    page = open_page(f"/ui/sessions/{cell.session_id}/repeatability")
    page.wait_for_selector("#scatter[data-ready=yes]")
    canvas = page.locator("#scatter canvas")
    before = page.evaluate("document.querySelector('#scatter canvas').toDataURL()")
    canvas.press("ArrowLeft")
    assert page.evaluate("document.querySelector('#scatter canvas').toDataURL()") != before
    page.click("#scatter summary")
    assert len(page.inner_text(".numbers tbody").splitlines()) == 10
    with page.expect_download() as saved:
        page.click("[data-csv]")
    assert Path(saved.value.path()).read_text(encoding="utf-8").startswith("pose_id,cycles,")
    # Narrower than the margins of the drawing, as while a window is dragged: smaller, and no error of the script.
    page.set_viewport_size({"width": 110, "height": 700})
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert page.evaluate("document.querySelector('#scatter canvas').width") < 92
    page.set_viewport_size({"width": 1280, "height": 900})
    page.select_option("select[name=estimator]", "per_image_fixed_pp")
    page.wait_for_url("**estimator=per_image_fixed_pp**")
    assert not page.troubles


def test_results_come_live_and_the_end_of_a_session_is_said(cell: Cell, open_page: Open) -> None:
    session_id = cell.api.make_session(cell.target_id, name="Live")
    page = open_page(f"/ui/sessions/{session_id}")
    assert "No image is here yet" in page.inner_text("main")
    image = cell.images[0]
    cell.api.put_image(session_id, image.data, "above_the_table", cycle=12)
    page.wait_for_selector(".tile.good")
    cut_off = "[...document.querySelectorAll('.tile .name')].some((one) => one.scrollWidth > one.clientWidth)"
    assert not page.evaluate(cut_off), "the cycle is read, too"
    assert page.inner_text(".count-succeeded") == "1"
    cell.api.client.delete(f"/v1/sessions/{session_id}")
    page.wait_for_selector("#notice:not([hidden])")
    assert "deleted" in page.inner_text("#notice")


def test_a_page_under_which_the_service_restarts_says_so_and_goes_on(cell: Cell, open_page: Open) -> None:
    page = open_page(f"/ui/sessions/{cell.session_id}")
    page.wait_for_selector(".tile")
    cell.api.service.stopping = True  # every stream ends, as when the service is asked to stop
    try:
        page.wait_for_selector("#connection:has-text('The connection is lost')")
    finally:
        cell.api.service.stopping = False
    page.wait_for_selector("#connection:has-text('Connected again')")
    assert page.locator(".tile").count() == 21


def test_a_key_revoked_under_an_open_page_leads_to_the_sign_in(cell: Cell, open_page: Open) -> None:
    key = new_key(cell)
    page = open_page(f"/ui/sessions/{cell.session_id}", key=key)
    page.wait_for_selector(".tile")
    key_id = f"key_{key.split('_')[1]}"
    assert cell.api.client.delete(f"/v1/keys/{key_id}").status_code == 204
    page.wait_for_selector("#notice:not([hidden])")
    assert "signed out" in page.inner_text("#notice")
    page.click("#notice a")
    page.wait_for_selector("#key")


def test_a_key_is_made_shown_once_and_revoked(cell: Cell, open_page: Open) -> None:
    page = open_page("/ui/keys")
    page.fill("#name", "PC of cell 4")
    page.select_option("#scope", "ingest")
    page.click("text=Make it")
    page.wait_for_selector("#new-key:not([hidden])")
    assert re.fullmatch(r"gp_[0-9a-z]{26}_[0-9a-f]{64}", page.inner_text("#secret"))
    page.wait_for_selector("#keys tr:has-text('PC of cell 4')")  # the table has it at once
    assert page.is_visible("#new-key")
    page.reload()
    assert not page.is_visible("#new-key")
    row = page.locator("tr", has_text="PC of cell 4")
    page.once("dialog", lambda dialog: dialog.accept())
    row.locator("text=Revoke").click()
    page.wait_for_selector("tr.quiet:has-text('PC of cell 4')")
    assert not page.troubles


def test_a_report_is_ordered_downloaded_and_verified(cell: Cell, open_page: Open) -> None:
    page = open_page(f"/ui/sessions/{cell.session_id}/reports")
    page.select_option("#kind", "repeatability")
    page.fill("#title", "To be filed")
    page.fill("#signatories", "R. Meier, operator\nM. Ito")
    page.click("text=Make it")
    page.wait_for_selector(
        "tr:has-text('To be filed') .badge.good", timeout=120_000
    )  # the list renews itself
    with page.expect_download() as download:
        page.click("tr:has-text('To be filed') >> text=PDF")
    assert download.value.path().read_bytes().startswith(b"%PDF-")
    page.click("text=To be filed")
    page.wait_for_url("**/ui/reports/rep_*")
    assert "R. Meier (operator), M. Ito" in page.inner_text("main")
    page.click("text=From the original images")
    page.wait_for_selector("#verification >> text=It agrees", timeout=120_000)
    assert "give the stored points to the last bit" in page.inner_text("#verification")
    assert not page.troubles
