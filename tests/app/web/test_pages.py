"""What pages show: sessions and their images, by filters and pages, in words."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace
from typing import Any

import pytest
import sqlalchemy as sa

from app.records.ids import least_id
from app.records.tables import Measurement, Result
from app.services.measurements import GalleryCounts
from app.services.measurements import gallery as gallery_counts
from app.services.reports import NewReport, order_report
from app.web.routes.sessions import next_step
from tests.support.service.signed_in import signed_in


@pytest.fixture
def session_id(api: Any, grey_png: bytes) -> str:
    """A session of 70 images: 60 wait, 6 failed for one reason, 4 for another; two are excluded."""
    made: str = api.make_session()
    ids = [
        api.put_image(made, grey_png + b"%d" % k, f"P{k % 7}", cycle=k + 1).json()["id"] for k in range(70)
    ]
    with api.installation.database.write() as records:
        for place, one in enumerate(ids):
            row = records.get_one(Measurement, one)
            if place < 10:
                row.status, row.failure_detail = "failed", "Nothing there."
                row.failure_code = "target_not_found" if place < 6 else "undecodable_image"
            if place in (20, 21):
                row.excluded = {"reason": "a hand", "by": None, "at": "2026-01-01T00:00:00Z"}
    return made


def tiles(page: str) -> list[str]:
    return re.findall(r'data-id="(mea_\w+)"', page)


def test_a_sessions_images_come_in_pages_and_by_filters(api: Any, session_id: str) -> None:
    def shown(query: str = "") -> list[str]:
        response = api.client.get(f"/ui/sessions/{session_id}{query}", headers=signed_in(api))
        assert response.status_code == 200, response.text
        return tiles(response.text)

    newest, rest = shown(), shown("?page=2")
    assert (len(newest), len(rest), len({*newest, *rest})) == (60, 10, 70)
    assert newest + rest == sorted(newest + rest, reverse=True)
    assert shown("?order=oldest")[0] == rest[-1]
    assert shown("?page=99") == rest  # beyond the last page is the last page
    for query, count in (
        *(("?state=failed", 10), ("?state=waiting", 60), ("?state=excluded", 2), ("?state=measured", 0)),
        *(("?code=target_not_found", 6), ("?pose=P3", 10), ("?pose=P0&state=failed", 2), ("?pose=%27%22", 0)),
        *(("?state=nonsense", 60),),
    ):
        assert len(shown(query)) == count, query


def test_images_of_one_stop_have_their_number_and_those_of_a_focus_group_its_name(
    api: Any, grey_png: bytes
) -> None:
    made = api.make_session()
    for k, given in enumerate(({}, {"burst": 2}, {"burst": 3, "focus_group": "near"}), 1):
        api.put_image(made, grey_png + b"%d" % k, "P2", cycle=2, **given)
    text = api.client.get(f"/ui/sessions/{made}", headers=signed_in(api)).text
    named = re.findall(r'class="name"><bdi>P2</bdi>(.*?)</span>', text)
    assert sorted(named) == [f" · cycle&nbsp;2{tail}" for tail in ("", " · image&nbsp;2", " · image&nbsp;3")]
    assert re.findall(r"focus group <bdi>(.*?)</bdi>", text) == ["near"]
    for k in (4, 5):
        api.put_image(made, grey_png + b"%d" % k, "P2")
    with api.installation.database.read() as records:
        assert gallery_counts.count_gallery(records, made).cycles == [
            ("P2", 3)
        ]  # a stop, and two images without one


def test_images_that_were_sent_together_are_in_the_order_of_their_cycles() -> None:
    """Fours at a time, the third before the second: as at a pose, and not across a pause or another pose."""
    begun = datetime(2026, 1, 1, tzinfo=UTC)

    def image(pose_id: str, cycle: int | None, seconds: float) -> Measurement:
        return Measurement(
            id=least_id("mea", begun + timedelta(seconds=seconds)), pose_id=pose_id, cycle=cycle, burst=1
        )

    received = [
        *(image("P1", cycle, k / 10) for k, cycle in enumerate((1, 3, 2, 4))),
        *(image("P2", 1, 0.5), image("P1", 6, 0.6), image("P1", 5, 0.7)),
        *(image("P1", 8, 60.0), image("P1", 7, 120.0)),  # visited in this order
        *(image("P3", None, 121.0), image("P3", None, 121.1)),
    ]
    oldest = gallery_counts.in_order_of_cycles(received, oldest_first=True)
    assert [one.cycle for one in oldest] == [1, 2, 3, 4, 1, 5, 6, 8, 7, None, None]
    assert oldest[-2:] == received[-2:], "without a cycle they stay as they came"
    newest = gallery_counts.in_order_of_cycles(received[::-1], oldest_first=False)
    assert newest == oldest[::-1]


def test_states_of_images_have_one_set_of_words_on_every_page(
    api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Measured or refused; of the measured ones some are weak, of the refused ones some have points that count."""
    made = api.make_session()
    ids = [api.put_image(made, grey_png + b"%d" % k, "P1", cycle=k + 1).json()["id"] for k in range(5)]
    words = ("measured", "measured, weak", "measured, weak", "refused", "refused, points used")
    with api.installation.database.write() as records:
        for one, word in zip(ids, words, strict=True):
            row = records.get_one(Measurement, one)
            row.status, row.failure_detail = "succeeded", "Nothing there."
            if word.startswith("refused"):
                row.status, row.failure_code = "failed", "focal_not_observable"
            if word == "refused":
                continue
            grade = {"grade": "weak" if "weak" in word else "determined"}
            calibration = None if word.startswith("refused") else grade
            hashes = {"content_sha256": "0" * 64, "input_sha256": "0" * 64}
            done = {"core_version": "0", "settings": {}, **hashes}
            records.add(Result(measurement_id=one, calibration=calibration, labelling="absolute", **done))

    def page(address: str) -> str:
        return str(api.client.get(f"/ui/{address}", headers=signed_in(api)).text)

    gallery = page(f"sessions/{made}")
    verdicts = re.findall(
        r'<span class="verdict"><span class="sign" aria-hidden="true">.</span> ([^<]+)</span>', gallery
    )
    assert [one.partition(":")[0] for one in reversed(verdicts)] == list(words)
    chips = dict(re.findall(r"<span>(\w+) <b>(\d+)</b></span>", gallery))
    assert chips == {"All": "5", "Measured": "3", "Weak": "2", "Refused": "2"}
    assert re.search(
        r"3</span> measured</span><span id=\"count-weak\"> \(2 weak\)</span>, .*2</span> refused", gallery
    )
    assert tiles(page(f"sessions/{made}?state=weak")) == [ids[2], ids[1]]
    assert "3 measured, " in page("")
    assert "2 refused" in page("")
    assert f"</span> {words[4]}</span>" in page(f"measurements/{ids[4]}")
    monkeypatch.setattr(gallery_counts, "MAX_GRADED", 4)
    assert "<span>Weak</span>" in page(f"sessions/{made}"), (
        "beyond the limit they are not counted, and can be chosen"
    )


def test_an_image_has_neighbours_and_says_why_it_was_refused(api: Any, session_id: str) -> None:
    ids = sorted(one["id"] for one in api.measurements(session_id))
    page = api.client.get(f"/ui/measurements/{ids[1]}", headers=signed_in(api)).text
    assert f'id="before" href="/ui/measurements/{ids[0]}"' in page
    assert f'id="after" href="/ui/measurements/{ids[2]}"' in page
    assert "Nothing there." in page
    assert 'id="before"' not in api.client.get(f"/ui/measurements/{ids[0]}", headers=signed_in(api)).text


@pytest.mark.slow
def test_pages_of_a_session_without_figures_say_why(api: Any, session_id: str) -> None:
    for tail in ("repeatability", "camera", "comparison", "robot?compute=1"):
        page = api.client.get(f"/ui/sessions/{session_id}/{tail}", headers=signed_in(api))
        assert page.status_code == 200, page.text
        assert 'class="refusal"' in page.text, tail


def test_sessions_are_found_by_name_and_robot(api: Any) -> None:
    ids = {name: api.make_session(name=name) for name in ("Cell 4 of 100 %", "cell_5", "Halle ÄÖ")}

    def found(query: str) -> set[str]:
        page = api.client.get(f"/ui/{query}", headers=signed_in(api)).text
        return {name for name, one in ids.items() if one in page}

    assert found("") == set(ids)
    assert found("?q=CELL") == {"Cell 4 of 100 %", "cell_5"}
    assert found("?q=100+%25") == {"Cell 4 of 100 %"}  # no wildcard
    assert found("?q=l_5") == {"cell_5"}
    assert found("?q=nothing") == found("?robot=rob_none") == set()


def test_a_session_changes_its_target_from_its_page(api: Any, session_id: str) -> None:
    other = api.make_target(columns=7, rows=5)
    page = api.client.get(f"/ui/sessions/{session_id}/change", headers=signed_in(api)).text
    assert f'data-action="/v1/sessions/{session_id}"' in page
    (mine,) = api.client.get(f"/v1/sessions/{session_id}").json()["target_ids"]
    ticked = re.findall(r'value="(tgt_\w+)" data-type="list" checked', page)
    assert (ticked, f'value="{other}" data-type="list">' in page) == ([mine], True)


def test_images_that_no_pose_repeats_lead_to_the_camera(api: Any, grey_png: bytes) -> None:
    made = api.make_session()
    ids = [api.put_image(made, grey_png + b"%d" % k, f"left{k}").json()["id"] for k in range(3)]
    with api.installation.database.write() as records:
        for one in ids:
            records.get_one(Measurement, one).status = "succeeded"
    page = api.client.get(f"/ui/sessions/{made}", headers=signed_in(api)).text
    assert "No pose has two images" in page
    assert f'<a href="/ui/sessions/{made}/camera">See the camera</a>' in page


def test_an_address_that_makes_no_sense_is_a_page_in_words(api: Any, session_id: str) -> None:
    for address, said in (
        (f"/ui/sessions/{session_id}?page=0", "<b>page</b>: must be at least 1"),
        ("/ui/targets/sheet.svg?columns=x", "<b>columns</b>: must be a whole number"),
        ("/ui/targets/sheet.svg?columns=9&rows=6&pitch_mm=0", "<b>pitch</b>: must be greater than 0"),
    ):
        response = api.client.get(address, headers=signed_in(api))
        assert (response.status_code, said in response.text) == (422, True), response.text


@pytest.mark.slow
def test_reports_are_listed_newest_first_and_say_why_one_could_not_be_made(api: Any, grey_png: bytes) -> None:
    """No process makes reports here: the rows are written as it would."""
    session_id, other = api.make_session(name="Halle <4>"), api.make_session(name="Halle 5")
    with api.installation.database.write() as records:
        new = NewReport(
            kind="camera", title=None, signatories=[{"name": "R. Meier", "role": None}], paper="a4"
        )
        first, second, third = (
            order_report(records, one, new).report for one in (session_id, session_id, other)
        )
        first.status = "failed"
        first.failure = {"code": "no_usable_images", "detail": "No image <counts>.", "advice": "Upload some."}

    def page(address: str) -> str:
        response = api.client.get(f"/ui/{address}", headers=signed_in(api))
        assert response.status_code == 200, response.text
        return str(response.text)

    listed = page("reports")
    assert re.findall(r"/ui/reports/(rep_\w+)", listed) == [third.id, second.id, first.id]
    assert "Halle &lt;4&gt;" in listed
    of_one = page(f"sessions/{session_id}/reports")
    assert re.findall(r"/ui/reports/(rep_\w+)", of_one) == [second.id, first.id]
    assert 'hx-trigger="every 2s"' in of_one, "a list with one that waits renews itself"
    failed = page(f"reports/{first.id}")
    assert "No image &lt;counts&gt;." in failed
    assert "Upload some." in failed
    assert f'href="/ui/sessions/{session_id}?state=failed">See the refused images' in failed
    assert "Does it still agree?" not in failed
    verified = page(f"reports/{second.id}/verification")
    assert "waits to be made" in verified, "what is not made cannot be verified, and its page says so"
    missing = api.client.get("/ui/reports/rep_none", headers=signed_in(api))
    assert missing.status_code == 404


def test_a_page_reads_as_often_for_many_images_as_for_few(api: Any, grey_png: bytes) -> None:
    """What a page costs the server does not grow with the images that it does not show."""
    few, many = api.make_session(name="few"), api.make_session(name="many")
    for session_id, count in ((few, 2), (many, 70)):
        for k in range(count):
            api.put_image(session_id, grey_png + f"{session_id} {k}".encode(), f"P{k % 7}", cycle=k + 1)
    headers = signed_in(api)

    def statements(address: str) -> int:
        asked: list[str] = []

        def note(*arguments: Any) -> None:
            asked.append(arguments[2])

        sa.event.listen(sa.Engine, "before_cursor_execute", note)
        try:
            assert api.client.get(address, headers=headers).status_code == 200
        finally:
            sa.event.remove(sa.Engine, "before_cursor_execute", note)
        return len([one for one in asked if "measurements" in one])

    statements(f"/ui/sessions/{few}")  # reads what is kept for the next ones
    assert 0 < statements(f"/ui/sessions/{many}") <= statements(f"/ui/sessions/{few}") <= 11


def test_images_that_only_the_session_can_answer_are_not_called_lost() -> None:
    counts = {"queued": 0, "running": 0, "succeeded": 2, "failed": 8, "duplicates": 0}
    detail: Any = SimpleNamespace(counts=counts, session=SimpleNamespace(id="ses_1"))
    flat = GalleryCounts(
        [("P1", 1), ("P2", 1)],
        [("P1", 1), ("P2", 1)],
        [("focal_not_observable", 7), ("target_not_found", 1)],
        0,
        0,
    )
    said = next_step(detail, flat)
    assert said is not None
    assert "these determine the camera" in said[0]
    lost = GalleryCounts(
        [("P1", 5), ("P2", 5)],
        [("P1", 5), ("P2", 5)],
        [("focal_not_observable", 5), ("target_not_found", 3)],
        0,
        0,
    )
    said = next_step(detail, lost)
    assert said is not None
    assert said[0].startswith("3 of 10 images were not measured, most often target not found.")


def test_the_services_address_leads_to_a_page_for_people(api: Any) -> None:
    response = api.client.get("/", headers={"Authorization": ""})
    assert response.status_code == 200
    assert response.headers["content-type"].startswith("text/html")
    assert response.url.path == "/ui/sign-in"
