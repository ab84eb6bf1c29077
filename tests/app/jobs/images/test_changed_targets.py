"""The targets of a session change: which images are searched again, and what becomes of their rows."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa

from app.analyses.inputs.snapshot import Snapshot
from app.analyses.inputs.snapshot_reader import read_snapshot
from app.jobs.queue import JobResult
from app.records.tables import Result
from tests.support.jobs.searches import shown


def change(api: Any, session_id: str, *target_ids: str) -> None:
    response = api.client.patch(f"/v1/sessions/{session_id}", json={"target_ids": target_ids})
    assert response.status_code == 200, response.text
    assert response.json()["target_ids"] == list(target_ids)


def search(api: Any, *places: int) -> list[str]:
    """Let the one job that waits find the targets at these places of its list; return what it searched for."""
    (job,) = api.installation.queue.claim(9)
    assert api.installation.queue.finish([JobResult(job, shown(job, *places), 100.0)]) == 1
    return [sought.target_id for sought in job.targets]


def rows(api: Any, session_id: str) -> list[tuple[Any, ...]]:
    return [(m["id"], m["target_id"], m["status"]) for m in api.measurements(session_id)]


def test_a_wrong_target_is_replaced_and_its_images_are_searched_again(any_api: Any, grey_png: bytes) -> None:
    api = any_api
    wrong, right = api.make_target(), api.make_target(columns=7)
    session_id = api.make_session(wrong)
    measurement_id = api.put_image(session_id, grey_png).json()["id"]
    search(api, 0)
    before = api.measurement(measurement_id)
    change(api, session_id, right)
    waiting = api.measurement(measurement_id)
    assert waiting == {**before, "status": "queued", "attempts": 0}, "the result stays until it is replaced"
    assert search(api, 0) == [right]
    assert rows(api, session_id) == [(measurement_id, right, "succeeded")]
    assert api.client.delete(f"/v1/targets/{wrong}").status_code == 204, "nothing refers to it any more"
    change(api, session_id, right)
    assert api.installation.queue.claim(9) == (), "the same targets change nothing"


def test_an_image_sent_with_a_target_that_went_is_searched_for_those_there_are(
    any_api: Any, grey_png: bytes
) -> None:
    api = any_api
    wrong, one, two = (api.make_target(columns=5 + k) for k in range(3))
    session_id = api.make_session(wrong, one)
    named = api.put_image(session_id, grey_png, target_id=wrong).json()["id"]
    search(api, 0)
    change(api, session_id, one, two)
    assert search(api, 0, 1) == [one, two]
    assert [row[1:] for row in rows(api, session_id)] == [(one, "succeeded"), (two, "succeeded")]
    assert api.put_image(session_id, grey_png).json()["id"] == named, (
        "it was searched as if sent without a target"
    )


def test_a_stated_target_that_comes_back_is_searched_alone(any_api: Any, grey_png: bytes) -> None:
    api = any_api
    a, b, c = (api.make_target(columns=5 + k) for k in range(3))
    session_id = api.make_session(a, b)
    of_b = api.put_image(session_id, grey_png, target_id=b).json()["id"]
    search(api, 0)
    change(api, session_id, a, c)
    assert search(api, 0, 1) == [a, c]
    meanwhile = api.measurements(session_id)
    assert [(m["target_id"], m["status"]) for m in meanwhile] == [(a, "succeeded"), (c, "succeeded")]
    change(api, session_id, a, b, c)
    assert rows(api, session_id) == [(of_b, b, "queued")], (
        "what was found meanwhile is no measurement any more"
    )
    (job,) = api.installation.queue.claim(9)
    assert job.has_explicit_target
    assert job.target_id == b
    assert api.measurement(of_b)["calibration"] is None, (
        "what was computed of the other target is not this one's"
    )


def test_a_target_taken_out_and_put_back_before_a_search_keeps_its_result(
    any_api: Any, grey_png: bytes
) -> None:
    api = any_api
    a, b = api.make_target(), api.make_target(columns=7)
    session_id = api.make_session(a, b)
    named = {
        target_id: api.put_image(session_id, grey_png, f"P{k}", target_id=target_id).json()["id"]
        for k, target_id in enumerate((a, b))
    }
    jobs = api.installation.queue.claim(9)
    api.installation.queue.finish([JobResult(job, shown(job), 1.0) for job in jobs])
    before = api.measurement(named[b])
    change(api, session_id, a)
    change(api, session_id, b, a)
    assert api.measurement(named[b]) == {**before, "status": "queued", "attempts": 0}
    (job,) = api.installation.queue.claim(9)
    assert (job.target_id, job.has_explicit_target) == (b, True)


def test_a_measurement_of_another_target_than_stated_says_so(any_api: Any, grey_png: bytes) -> None:
    api = any_api
    a, b = api.make_target(), api.make_target(columns=7)
    session_id = api.make_session(a, b)
    measurement_id = api.put_image(session_id, grey_png, target_id=b).json()["id"]

    def warned() -> list[bool]:
        with api.installation.database.read() as records:
            found = records.scalars(sa.select(Result.points_warnings)).all()
        return ["stated_target_removed" in {one["code"] for one in stored or ()} for stored in found]

    change(api, session_id, a)
    search(api, 0)
    assert warned() == [True]
    assert api.client.post(f"/v1/measurements/{measurement_id}/retry").status_code == 202
    search(api, 0)
    assert warned() == [True], "the only target is searched for by itself"
    snapshot = snapshot_of(api, session_id)
    assert [image.stated_target_id for image in snapshot.images] == [b]
    change(api, session_id, b)
    search(api, 0)
    assert warned() == [False]
    assert [image.stated_target_id for image in snapshot_of(api, session_id).images] == [None]


def snapshot_of(api: Any, session_id: str) -> Snapshot:
    with api.installation.database.read() as records:
        return read_snapshot(records, session_id)


def test_where_nothing_is_found_the_measurement_has_no_target(any_api: Any, grey_png: bytes) -> None:
    api = any_api
    first, second = api.make_target(), api.make_target(columns=7)
    session_id = api.make_session(first)
    measurement_id = api.put_image(session_id, grey_png).json()["id"]
    search(api, 0)
    change(api, session_id, second)
    search(api)
    assert rows(api, session_id) == [(measurement_id, None, "failed")]
    change(api, session_id, first)
    assert search(api, 0) == [first]
    assert rows(api, session_id) == [(measurement_id, first, "succeeded")]


def test_rows_of_targets_that_went_are_used_before_new_ones(any_api: Any, grey_png: bytes) -> None:
    api = any_api
    targets = [api.make_target(columns=5 + k) for k in range(5)]
    session_id = api.make_session(*targets[:2])
    api.put_image(session_id, grey_png)
    search(api, 0, 1)
    before = rows(api, session_id)
    change(api, session_id, *targets[2:])
    assert search(api, 0, 1, 2) == targets[2:]
    after = rows(api, session_id)
    assert [row[0] for row in after[:2]] == [row[0] for row in before]
    assert [row[1] for row in after] == targets[2:]
    assert api.measurement(after[1][0])["attempts"] == 2


def test_new_targets_are_searched_in_images_sent_without_one(any_api: Any, grey_png: bytes) -> None:
    api = any_api
    first, second = api.make_target(), api.make_target(columns=7)
    session_id = api.make_session(first)
    unnamed = api.put_image(session_id, grey_png, "P1").json()["id"]
    search(api, 0)
    named = api.put_image(session_id, grey_png, "P2", target_id=first).json()["id"]
    search(api, 0)
    change(api, session_id, second, first)
    assert api.measurement(named)["status"] != "queued", "it was said which target the image is of"
    assert search(api, 0, 1) == [second, first]
    at_p1 = [row[:2] for row in rows(api, session_id) if row[0] != named]
    assert at_p1 == [(unnamed, first), (at_p1[1][0], second)]
    # Without the second again, every image has a measurement of what is left.
    change(api, session_id, first)
    assert api.installation.queue.claim(9) == ()


def test_what_an_added_target_gives_takes_the_place_of_a_failed_search(any_api: Any, grey_png: bytes) -> None:
    api = any_api
    wrong, right = api.make_target(), api.make_target(columns=7)
    session_id = api.make_session(wrong)
    measurement_id = api.put_image(session_id, grey_png).json()["id"]
    search(api)
    assert rows(api, session_id) == [(measurement_id, wrong, "failed")]
    change(api, session_id, wrong, right)
    assert search(api, 1) == [wrong, right]
    assert rows(api, session_id) == [(measurement_id, right, "succeeded")]
    counts = api.client.get(f"/v1/sessions/{session_id}").json()["counts"]
    assert (counts["succeeded"], counts["failed"]) == (1, 0)
    # Of both in the image, each has its measurement.
    assert api.client.post(f"/v1/measurements/{measurement_id}/retry").status_code == 202
    search(api, 0, 1)
    assert sorted(row[1:] for row in rows(api, session_id)) == sorted(
        [(right, "succeeded"), (wrong, "succeeded")]
    )


def test_a_target_that_cannot_be_is_refused_and_nothing_changes(any_api: Any, grey_png: bytes) -> None:
    target_id = any_api.make_target()
    session_id = any_api.make_session(target_id)
    any_api.put_image(session_id, grey_png)
    search(any_api, 0)
    before = any_api.measurements(session_id)
    for wrong in ([f"tgt_{'0' * 26}"], [target_id, target_id], []):
        refused = any_api.client.patch(f"/v1/sessions/{session_id}", json={"target_ids": wrong})
        assert refused.status_code == 422
    assert any_api.measurements(session_id) == before
