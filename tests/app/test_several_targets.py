"""Images that name no target, in sessions with several: searched, and a measurement for each target shown."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import pytest
import sqlalchemy as sa

from app.jobs.queue import Finished, Job
from app.records.codec import Failure, Outcome, Provenance, Shown, encode_refused
from core import TargetSpec
from core.simulation import render
from core.transforms import invert
from tests.room_corner import SIZE_PX, Corner, png

CHESSBOARD = TargetSpec("chessboard", 8, 5, 18.0)
SMALLER = TargetSpec("chessboard", 7, 4, 20.0)
CHARUCO = TargetSpec("charuco", 6, 5, 22.0, marker_mm=16.0, dictionary="DICT_5X5_100")
OTHER_MARKERS = TargetSpec("charuco", 5, 5, 22.0, marker_mm=16.0, dictionary="DICT_4X4_50")
NOTHING = Failure("target_not_found", "Nothing there.", "Look elsewhere.")


def make_targets(api: Any, *specs: TargetSpec) -> list[str]:
    return [api.make_target(**dataclasses.asdict(spec)) for spec in specs]


def listed(api: Any, session_id: str) -> list[dict[str, Any]]:
    items: list[dict[str, Any]] = api.client.get(f"/v1/sessions/{session_id}/measurements").json()["items"]
    return items


@pytest.fixture(scope="module")
def corner() -> Corner:
    return Corner(CHESSBOARD, CHARUCO)


@pytest.fixture(scope="module")
def picture(corner: Corner) -> bytes:
    return corner.picture(corner.view(turn=0.3), seed=3)


@pytest.mark.parametrize(
    "specs",
    [(CHESSBOARD, CHARUCO), (OTHER_MARKERS, CHARUCO), (SMALLER, CHESSBOARD)],
    ids=["kinds", "ids", "sizes"],
)
def test_both_grids_of_a_corner_are_measured(computing_api: Any, specs: tuple[TargetSpec, ...]) -> None:
    api, corner = computing_api, Corner(*specs)
    T_camera_ahead = corner.view(turn=0.2, lift_mm=20.0)
    data = corner.picture(T_camera_ahead, seed=1)
    absent, *targets = make_targets(api, TargetSpec("circles", 6, 5, 20.0), *specs)
    session_id = api.make_session(absent, *targets)
    accepted = api.put_image(session_id, data, cycle=2, joint_angles_deg="1,2", focus_group="near")
    assert (accepted.status_code, accepted.json()["target_id"]) == (202, None)
    first = api.wait_for(accepted.json()["id"])
    both = listed(api, session_id)
    assert [m["target_id"] for m in both] == targets
    assert both[0] == first
    assert [m["siblings"] for m in both] == [[both[1]["id"]], [both[0]["id"]]]
    same = (
        "pose_id",
        "sha256",
        "cycle",
        "joint_angles_deg",
        "focus_group",
        "received_at",
        "bytes",
        "filename",
    )
    assert [both[1][name] for name in same] == [both[0][name] for name in same]
    assert [m["attempts"] for m in both] == [1, 1]
    assert (
        both[0]["duration_ms"] > both[1]["duration_ms"] > 0.0
    )  # the first one's holds decoding and searching
    for measurement, scene in zip(both, corner.scenes(T_camera_ahead), strict=True):
        assert measurement["status"] == "succeeded"
        assert api.client.get(f"/v1/measurements/{measurement['id']}").json() == measurement
        assert measurement["origin"] in ("known", "turned")
        quality = measurement["capture_quality"]
        tilt = measurement["calibration"]["observability"]["tilt_deg"]
        assert quality["tilt_deg"] == pytest.approx(tilt, abs=1e-9)
        pose = measurement["calibration"]["pose"]
        error = np.array(pose["position_mm"]) - invert(scene.T_camera_target)[:3, 3]
        if measurement["origin"] == "known":
            # Five standard uncertainties: one image of one seed, which must not fail by mere chance.
            assert np.all(np.abs(error) < 5.0 * np.sqrt(np.diag(pose["covariance"])[:3]))
        for ending in ("image", "overlay"):
            assert api.client.get(f"/v1/measurements/{measurement['id']}/{ending}").status_code == 200
    counts = api.client.get(f"/v1/sessions/{session_id}").json()["counts"]
    assert counts == {"queued": 0, "running": 0, "succeeded": 2, "failed": 0, "already_measured": 0}
    again = api.put_image(session_id, data)
    assert (again.status_code, again.json()) == (200, first)
    for measurement in both:
        named = api.put_image(session_id, data, target_id=measurement["target_id"])
        assert (named.status_code, named.json()) == (200, measurement)
    ask = {"images": [{"pose_id": "P1", "sha256": first["sha256"]}]}
    missing = api.client.post(f"/v1/sessions/{session_id}/images/missing", json=ask).json()
    assert missing == {"missing": []}
    assert api.client.delete(f"/v1/sessions/{session_id}").status_code == 204
    assert not api.installation.blobs.path(first["sha256"]).exists()


def test_a_target_found_is_measured_as_one_that_is_named(computing_api: Any, picture: bytes) -> None:
    api, targets = computing_api, make_targets(computing_api, CHESSBOARD, CHARUCO)
    named, searched = api.make_session(*targets), api.make_session(*targets)
    by_name = [
        api.wait_for(api.put_image(named, picture, target_id=target_id).json()["id"]) for target_id in targets
    ]
    api.wait_for(api.put_image(searched, picture).json()["id"])
    by_search = listed(api, searched)
    for one, other in zip(by_name, by_search, strict=True):
        for field in ("calibration", "origin", "capture_quality", "target_id", "status"):
            assert one[field] == other[field]
        points = [
            api.client.get(f"/v1/measurements/{m['id']}?include=points").json()["points"]
            for m in (one, other)
        ]
        assert points[0] == points[1]
    assert api.client.get(f"/v1/measurements/{by_name[0]['id']}").json()["siblings"] == [by_name[1]["id"]]


def test_what_was_measured_by_name_joins_as_a_sibling(computing_api: Any, picture: bytes) -> None:
    api, targets = computing_api, make_targets(computing_api, CHESSBOARD, CHARUCO)
    session_id = api.make_session(*targets)
    by_name = api.wait_for(api.put_image(session_id, picture, target_id=targets[0]).json()["id"])
    searched = api.wait_for(api.put_image(session_id, picture).json()["id"])
    assert (searched["status"], searched["target_id"]) == ("succeeded", targets[1])
    assert searched["siblings"] == [by_name["id"]]
    unchanged = api.client.get(f"/v1/measurements/{by_name['id']}").json()
    assert unchanged == {**by_name, "siblings": [searched["id"]]}


def test_nothing_left_to_measure_is_said_and_nothing_is_lost(computing_api: Any, corner: Corner) -> None:
    api, targets = computing_api, make_targets(computing_api, CHESSBOARD, CHARUCO)
    ahead, _ = corner.scenes(corner.view(turn=0.1))
    data = png(render(ahead))
    session_id = api.make_session(*targets)
    by_name = api.wait_for(api.put_image(session_id, data, target_id=targets[0]).json()["id"])
    searched = api.wait_for(api.put_image(session_id, data).json()["id"])
    assert (searched["status"], searched["failure"]["code"]) == ("failed", "target_already_measured")
    assert searched["failure"]["advice"]
    assert searched["target_id"] is None
    assert searched["siblings"] == [by_name["id"]]
    assert [m["id"] for m in listed(api, session_id)] == [by_name["id"], searched["id"]]
    assert api.client.get(f"/v1/sessions/{session_id}/intrinsics").status_code == 200


def test_what_was_measured_already_is_not_counted_as_failed(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    session_id, targets, _ = seek(any_api, grey_png)
    any_api.put_image(session_id, grey_png, target_id=targets[0])
    other, _, _ = seek(any_api, grey_png)
    searched, named, vain = queue.claim(3)
    for job, outcome in (
        (named, dataclasses.replace(shown(named), failure=None)),
        (searched, shown(searched, 0)),
        (vain, shown(vain)),
    ):
        assert queue.finish([Finished(job, outcome, 1.0)]) == 1

    def counts(session: str) -> dict[str, int]:
        return dict(any_api.client.get(f"/v1/sessions/{session}").json()["counts"])

    nothing = {"queued": 0, "running": 0, "succeeded": 0, "failed": 0, "already_measured": 0}
    assert counts(session_id) == {**nothing, "succeeded": 1, "already_measured": 1}
    assert counts(other) == {**nothing, "failed": 1}
    pages = any_api.client.get("/v1/sessions").json()["items"]
    assert {item["id"]: item["counts"] for item in pages} == {id_: counts(id_) for id_ in (session_id, other)}
    metrics = any_api.client.get("/metrics").text
    for status, number in (("succeeded", 1), ("failed", 1), ("already_measured", 1), ("queued", 0)):
        assert f'gridpose_measurements{{status="{status}"}} {number}.0' in metrics
    # The row itself is found among those that failed, with its code and what to do about it.
    (row,) = any_api.client.get(f"/v1/sessions/{session_id}/measurements?status=failed").json()["items"]
    assert row["failure"]["code"] == "target_already_measured"


def test_an_image_of_none_says_what_was_looked_for(
    computing_api: Any, picture: bytes, grey_png: bytes
) -> None:
    api, targets = computing_api, make_targets(computing_api, SMALLER, OTHER_MARKERS, CHESSBOARD, CHARUCO)
    session_id = api.make_session(*targets[:2])
    nothing = api.wait_for(api.put_image(session_id, grey_png).json()["id"])
    assert (nothing["status"], nothing["failure"]["code"]) == ("failed", "target_not_found")
    assert nothing["target_id"] is nothing["origin"] is nothing["capture_quality"] is None
    for word in ("chessboard 7 x 4", "charuco 5 x 5", *targets[:2]):
        assert word in nothing["failure"]["detail"]
    other = api.wait_for(api.put_image(session_id, picture).json()["id"])
    assert (other["failure"]["code"], other["target_id"]) == ("target_mismatch", None)
    assert "chessboard 7 x 4" in other["failure"]["detail"]
    problem = api.client.get(f"/v1/sessions/{session_id}/repeatability")
    assert (problem.status_code, problem.json()["code"]) == (409, "nothing_usable")
    # Once the session knows what it shows, the same image is searched anew.
    api.client.patch(f"/v1/sessions/{session_id}", json={"target_ids": targets})
    assert api.client.post(f"/v1/measurements/{other['id']}/retry").status_code == 202
    found = api.wait_for(other["id"])
    assert (found["status"], found["target_id"]) == ("succeeded", targets[2])
    (sibling,) = found["siblings"]
    assert api.client.get(f"/v1/measurements/{sibling}").json()["target_id"] == targets[3]


def test_boards_that_look_alike_are_not_guessed(computing_api: Any, corner: Corner) -> None:
    api = computing_api
    targets = make_targets(api, CHESSBOARD, dataclasses.replace(CHESSBOARD, pitch_mm=9.0))
    ahead, _ = corner.scenes(corner.view())
    measurement = api.wait_for(api.put_image(api.make_session(*targets), png(render(ahead))).json()["id"])
    assert (measurement["status"], measurement["failure"]["code"]) == ("failed", "target_ambiguous")
    assert measurement["target_id"] is None
    assert measurement["siblings"] == []
    assert "target_id" in measurement["failure"]["advice"]
    detail = measurement["failure"]["detail"]
    assert "None of" not in detail
    for words in ("look alike", *targets):
        assert words in detail


def test_a_refused_view_is_shown_all_the_same(computing_api: Any, corner: Corner) -> None:
    api, targets = computing_api, make_targets(computing_api, CHARUCO, CHESSBOARD)
    T = np.eye(4)
    T[:3, 3] = -70.0, -40.0, 420.0
    flat, _ = corner.scenes(T)
    measurement = api.wait_for(api.put_image(api.make_session(*targets), png(render(flat))).json()["id"])
    assert (measurement["failure"]["code"], measurement["target_id"]) == ("focal_not_observable", targets[1])
    assert measurement["origin"] is not None
    assert measurement["capture_quality"]["advice"]
    points = api.client.get(f"/v1/measurements/{measurement['id']}?include=points").json()["points"]
    assert len(points) == CHESSBOARD.size


def test_a_damaged_file_is_no_target(computing_api: Any, picture: bytes) -> None:
    targets = make_targets(computing_api, CHARUCO, CHESSBOARD)
    response = computing_api.put_image(computing_api.make_session(*targets), picture[: len(picture) // 2])
    measurement = computing_api.wait_for(response.json()["id"])
    assert (measurement["failure"]["code"], measurement["target_id"]) == ("undecodable_image", None)


# The queue by itself, on both databases, with computations of our own invention.


def shown(job: Job, *places: int, failure: Failure | None = None) -> Outcome:
    """An outcome in which the targets at these places of the session's list are shown."""
    nothing = encode_refused(None, Provenance("1", job.sha256, {}))
    return Outcome(
        nothing,
        NOTHING,
        tuple(Shown(job.targets[place].target_id, nothing, failure, 10.0 + place) for place in places),
    )


def seek(api: Any, data: bytes, targets: int = 3) -> tuple[str, list[str], str]:
    """A session with targets and an image that names none: session, targets, measurement."""
    ids = [api.make_target(columns=5 + k) for k in range(targets)]
    session_id = api.make_session(*ids)
    return session_id, ids, api.put_image(session_id, data).json()["id"]


def test_what_is_shown_is_written_once(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    session_id, targets, measurement_id = seek(any_api, grey_png)
    (stale,) = queue.claim(1)
    assert [sought.target_id for sought in stale.targets] == targets
    assert (stale.target_id, stale.names_its_target) == (None, False)
    queue.recover()
    (job,) = queue.claim(1)
    assert queue.finish([Finished(stale, shown(stale, 0, 1), 100.0)]) == 0
    assert len(listed(any_api, session_id)) == 1
    finished = Finished(job, shown(job, 1, 2), 100.0)
    assert queue.finish([finished, finished]) == 1
    both = listed(any_api, session_id)
    assert [(m["target_id"], m["status"], m["attempts"]) for m in both] == [
        (targets[1], "succeeded", 1),
        (targets[2], "succeeded", 1),
    ]
    assert [m["duration_ms"] for m in both] == [88.0, 12.0]
    assert both[0]["id"] == measurement_id
    assert both[0]["finished_at"] == both[1]["finished_at"]
    assert queue.claim(9) == ()


def test_what_came_by_name_meanwhile_is_left_alone(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    session_id, targets, _ = seek(any_api, grey_png)
    (job,) = queue.claim(1)
    by_name = any_api.put_image(session_id, grey_png, target_id=targets[0]).json()
    assert queue.finish([Finished(job, shown(job, 0, 1), 100.0)]) == 1
    first, other = listed(any_api, session_id)
    assert (first["target_id"], first["status"], first["duration_ms"]) == (targets[1], "succeeded", 100.0)
    assert (other["id"], other["status"]) == (by_name["id"], "queued")
    (named,) = queue.claim(9)
    assert named.names_its_target
    assert [sought.target_id for sought in named.targets] == targets[:1]


@pytest.mark.parametrize("places", [(0, 1), (1,)], ids=["both", "the one taken away"])
def test_a_target_taken_from_the_session_during_the_search_gets_no_row(
    any_api: Any, grey_png: bytes, places: tuple[int, ...]
) -> None:
    queue = any_api.installation.queue
    session_id, (kept, gone), measurement_id = seek(any_api, grey_png, targets=2)
    (job,) = queue.claim(1)
    changed = any_api.client.patch(f"/v1/sessions/{session_id}", json={"target_ids": [kept]})
    assert changed.status_code == 200
    assert queue.finish([Finished(job, shown(job, *places), 100.0)]) == 1
    (row,) = listed(any_api, session_id)
    assert row["id"] == measurement_id
    if 0 in places:
        assert (row["status"], row["target_id"]) == ("succeeded", kept)
    else:
        assert (row["failure"]["code"], row["target_id"]) == ("target_not_found", None)
        assert kept in row["failure"]["detail"]
        assert f"shows {gone}" in row["failure"]["detail"]
    for analysis in ("intrinsics", "repeatability", "comparison", "dh"):
        assert any_api.client.get(f"/v1/sessions/{session_id}/{analysis}").status_code == 409
    # What is measured or queued by name holds its target fast.
    back = any_api.client.patch(f"/v1/sessions/{session_id}", json={"target_ids": [kept, gone]})
    assert back.status_code == 200
    any_api.put_image(session_id, grey_png, target_id=gone)
    refused = any_api.client.patch(f"/v1/sessions/{session_id}", json={"target_ids": [kept]})
    assert (refused.status_code, refused.json()["code"]) == (422, "target_in_use")


def test_a_deleted_session_takes_the_search_with_it(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    session_id, _, _ = seek(any_api, grey_png)
    (job,) = queue.claim(1)
    assert any_api.client.delete(f"/v1/sessions/{session_id}").status_code == 204
    assert queue.finish([Finished(job, shown(job, 0, 1), 100.0)]) == 0


def test_a_retry_looks_again_for_all(any_api: Any, grey_png: bytes) -> None:
    api, queue = any_api, any_api.installation.queue
    session_id, targets, measurement_id = seek(api, grey_png)

    def again(*places: int, failure: Failure | None = None) -> list[dict[str, Any]]:
        (job,) = queue.claim(9)
        assert [sought.target_id for sought in job.targets] == targets
        assert queue.finish([Finished(job, shown(job, *places, failure=failure), 100.0)]) == 1
        return listed(api, session_id)

    (nothing,) = again()
    assert (nothing["status"], nothing["target_id"]) == ("failed", None)
    retry = f"/v1/measurements/{measurement_id}/retry"
    assert api.client.post(retry).json()["target_id"] is None
    (one,) = again(1)
    assert (one["status"], one["target_id"]) == ("succeeded", targets[1])
    # The row keeps its target; those missed before become rows, those that have one keep it as it is.
    assert api.client.post(retry).json()["target_id"] == targets[1]
    one, two = again(0, 1)
    assert [m["target_id"] for m in (one, two)] == [targets[1], targets[0]]
    assert (one["duration_ms"], two["duration_ms"]) == (90.0, 10.0)
    queued = api.client.post(retry).json()
    assert queued["siblings"] == [two["id"]]
    one, unchanged, three = again(0, 2, failure=NOTHING)
    assert unchanged == {**two, "siblings": [one["id"], three["id"]]}
    assert (one["status"], one["failure"]["code"], one["target_id"]) == (
        "failed",
        "target_not_found",
        targets[1],
    )
    assert (three["status"], three["target_id"]) == ("failed", targets[2])
    # A sibling's retry is about its own target.
    assert api.client.post(f"/v1/measurements/{two['id']}/retry").status_code == 202
    (job,) = queue.claim(9)
    assert job.names_its_target
    assert [sought.target_id for sought in job.targets] == targets[:1]


def test_three_crashes_of_a_search_are_the_end_of_it(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    _, _, measurement_id = seek(any_api, grey_png)
    for _ in range(3):
        (job,) = queue.claim(1)
        queue.crashed(job)
    document = any_api.client.get(f"/v1/measurements/{measurement_id}").json()
    assert (document["status"], document["failure"]["code"]) == ("failed", "worker_crashed")
    assert document["target_id"] is None


def test_a_page_asks_as_often_for_many_siblings_as_for_few(api: Any, grey_png: bytes) -> None:
    queue = api.installation.queue
    targets = [api.make_target(columns=5 + k) for k in range(2)]
    sessions = [api.make_session(*targets), api.make_session(*targets)]
    for session_id, poses in zip(sessions, (1, 20), strict=True):
        for pose in range(poses):
            api.put_image(session_id, grey_png, f"P{pose}")
    while jobs := queue.claim(50):
        queue.finish([Finished(job, shown(job, 0, 1), 100.0) for job in jobs])
    statements: list[str] = []

    def note(_connection: Any, _cursor: Any, statement: str, *_rest: Any) -> None:
        statements.append(statement)

    engines = {api.installation.database.engine, api.installation.database._reader}
    for engine in engines:
        sa.event.listen(engine, "before_cursor_execute", note)
    counts = []
    for session_id, items in zip(sessions, (2, 40), strict=True):
        statements.clear()
        page = listed(api, session_id)
        assert [len(m["siblings"]) for m in page] == [1] * items
        counts.append(len(statements))
    assert counts[0] == counts[1]
    assert _reads_by_index(api, statements[-1])


def _reads_by_index(api: Any, statement: str) -> bool:
    """Tell whether SQLite looks rows up by pose and hash, rather than reading a session's whole list."""
    fixed = statement
    while "?" in fixed:
        fixed = fixed.replace("?", "'x'", 1)
    with api.installation.database.read() as records:
        plan: Sequence[Any] = records.execute(sa.text(f"EXPLAIN QUERY PLAN {fixed}")).all()
    told = " ".join(str(row) for row in plan)
    return "pose_id=?" in told and "SCAN" not in told


def test_the_quality_is_that_of_the_picture(computing_api: Any, corner: Corner, picture: bytes) -> None:
    targets = make_targets(computing_api, CHESSBOARD, CHARUCO)
    session_id = computing_api.make_session(*targets)
    first = computing_api.wait_for(computing_api.put_image(session_id, picture).json()["id"])
    quality = first["capture_quality"]
    view = corner.view(turn=0.3)
    assert quality["tilt_deg"] == pytest.approx(math.degrees(math.acos(abs(view[2, 2]))), abs=1.0)
    outline = cv2.convexHull(corner.scenes(view)[0].points_px.astype(np.float32))
    share = cv2.contourArea(outline) / math.prod(SIZE_PX)
    assert quality["coverage_fraction"] == pytest.approx(share, rel=0.01)
    assert 2.0 < quality["edge_width_px"] < 4.0  # 10-90 % of a Gaussian of 1 px and of a pixel's square: 2.7
    assert quality["saturated_fraction"] == quality["clipped_fraction"] == 0.0
