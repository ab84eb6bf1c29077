"""Corrections of an image: what moves together, what is refused, what analyses then do."""

from __future__ import annotations

from typing import Any

import pytest
import sqlalchemy as sa

from app.jobs.queue import JobResult
from app.records.ids import new_id
from app.records.tables import Measurement
from tests.support.jobs.computations import DONE
from tests.support.service.service import assert_problem


def patch(api: Any, measurement_id: str, **changes: Any) -> Any:
    return api.client.patch(f"/v1/measurements/{measurement_id}", json=changes)


def add_sibling(api: Any, measurement_id: str, target_id: str) -> str:
    """Store another measurement of the same image, as a search that found a second target does."""
    with api.installation.database.write() as records:
        row = records.get(Measurement, measurement_id)
        columns = {column.name: getattr(row, column.name) for column in Measurement.__table__.columns}
        changes = {"id": new_id("mea"), "target_id": target_id, "seeks_target": False}
        records.add(Measurement(**{**columns, **changes}))
        return str(changes["id"])


@pytest.fixture
def pair(any_api: Any, grey_png: bytes) -> tuple[str, list[str]]:
    """A session with two targets, and the two measurements of one image."""
    targets = [any_api.make_target(), any_api.make_target()]
    session_id = any_api.make_session(*targets)
    first = any_api.put_image(session_id, grey_png, cycle=1).json()["id"]
    with any_api.installation.database.write() as records:
        records.execute(sa.update(Measurement).values(target_id=targets[0]))
    return session_id, [first, add_sibling(any_api, first, targets[1])]


def test_what_belongs_to_the_image_changes_in_all_its_measurements(
    any_api: Any, pair: tuple[str, list[str]]
) -> None:
    api, (session_id, ids) = any_api, pair
    changes = {"pose_id": "P7", "cycle": 3, "burst": 2, "focus_group": "near", "joint_angles_deg": [1.0, 2.0]}
    changed = patch(api, ids[0], **changes)
    assert changed.status_code == 200, changed.text
    assert changed.json()["siblings"] == [ids[1]]
    for measurement_id in ids:
        document = api.measurement(measurement_id)
        assert {name: document[name] for name in changes} == changes
        assert document["status"] == "queued"
    pose = api.client.get(f"/v1/sessions/{session_id}/poses/P7")
    assert (pose.status_code, pose.json()["joint_angles_deg"]) == (200, None), "made as images make it"
    assert patch(api, ids[1], cycle=None, burst=None, joint_angles_deg=None).json()["pose_id"] == "P7"
    assert api.measurement(ids[0])["cycle"] is None
    assert api.measurement(ids[0])["joint_angles_deg"] is None
    assert patch(api, ids[0]).json() == api.measurement(ids[0]), "nothing named, nothing changed"


def test_an_exclusion_is_of_one_measurement_and_can_be_undone(
    any_api: Any, pair: tuple[str, list[str]]
) -> None:
    api, (_, ids) = any_api, pair
    excluded = patch(api, ids[0], excluded={"reason": "A hand in front."}).json()["excluded"]
    assert (excluded["reason"], excluded["by"]) == ("A hand in front.", "admin")
    assert excluded["at"].endswith("Z")
    assert api.measurement(ids[0])["excluded"] == excluded
    assert api.measurement(ids[1])["excluded"] is None
    patch(api, ids[0], cycle=2)
    assert api.measurement(ids[0])["excluded"] == excluded, "another correction leaves it"
    assert patch(api, ids[0], excluded=None).json()["excluded"] is None


def test_an_image_cannot_be_twice_at_a_pose(any_api: Any, grey_png: bytes) -> None:
    api = any_api
    session_id = api.make_session()
    first, second = (api.put_image(session_id, grey_png, pose).json()["id"] for pose in ("P1", "P2"))
    problem = assert_problem(patch(api, second, pose_id="P1", cycle=9), 409, "image_already_at_pose")
    assert first in problem["detail"]
    assert [error["field"] for error in problem["errors"]] == ["pose_id"]
    kept = api.measurement(second)
    assert (kept["pose_id"], kept["cycle"]) == ("P2", None)
    assert patch(api, second, pose_id="P2").status_code == 200, "its own place is free"


def test_another_target_of_the_image_joins_its_siblings(any_api: Any, grey_png: bytes) -> None:
    targets = [any_api.make_target(), any_api.make_target()]
    session_id = any_api.make_session(*targets)
    first = any_api.put_image(session_id, grey_png, "P1", target_id=targets[0]).json()["id"]
    second = any_api.put_image(session_id, grey_png, "P2", target_id=targets[1]).json()["id"]
    assert patch(any_api, second, pose_id="P1").json()["siblings"] == [first]


def test_a_correction_while_the_image_is_computed_is_kept(any_api: Any, grey_png: bytes) -> None:
    measurement_id = any_api.put_image(any_api.make_session(), grey_png).json()["id"]
    (job,) = any_api.installation.queue.claim(1)
    assert patch(any_api, measurement_id, pose_id="P9").json()["status"] == "running"
    assert any_api.installation.queue.finish([JobResult(job, DONE, 1.0)]) == 1
    document = any_api.measurement(measurement_id)
    assert (document["pose_id"], document["status"]) == ("P9", "failed")


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"pose_id": None}, "pose_id"),
        ({"pose_id": ".hidden"}, "pose_id"),
        ({"pose_id": ""}, "pose_id"),
        ({"cycle": 0}, "cycle"),
        ({"cycle": "x"}, "cycle"),
        ({"burst": 0}, "burst"),
        ({"burst": 1001}, "burst"),
        ({"focus_group": None}, "focus_group"),
        ({"focus_group": "\0"}, "focus_group"),
        ({"joint_angles_deg": []}, "joint_angles_deg"),
        ({"joint_angles_deg": [1e9]}, "joint_angles_deg.0"),
        ({"joint_angles_deg": [0.0] * 13}, "joint_angles_deg"),
        ({"excluded": {}}, "excluded.reason"),
        ({"excluded": {"reason": ""}}, "excluded.reason"),
        ({"excluded": {"reason": "x" * 201}}, "excluded.reason"),
        ({"excluded": {"reason": "x", "by": "me"}}, "excluded.by"),
        ({"excluded": "x"}, "excluded"),
        ({"target_id": "x"}, "target_id"),
        ({"sha256": "0" * 64}, "sha256"),
    ],
)
def test_bad_corrections_are_refused_by_their_field(
    api: Any, grey_png: bytes, change: dict[str, Any], field: str
) -> None:
    measurement_id = api.put_image(api.make_session(), grey_png).json()["id"]
    before = api.measurement(measurement_id)
    problem = assert_problem(patch(api, measurement_id, **change), 422, "invalid_request")
    assert field in [error["field"] for error in problem["errors"]]
    assert api.measurement(measurement_id) == before


def test_a_burst_index_without_a_cycle_names_no_stop(api: Any, grey_png: bytes) -> None:
    session_id = api.make_session()
    problem = assert_problem(api.put_image(session_id, grey_png, burst=2), 422, "burst_without_cycle")
    assert [error["field"] for error in problem["errors"]] == ["burst"]
    form = api.client.post(
        f"/v1/sessions/{session_id}/images",
        data={"pose_id": "P1", "burst": "2"},
        files={"image": ("a.png", grey_png)},
    )
    assert_problem(form, 422, "burst_without_cycle")
    stored = api.put_image(session_id, grey_png, cycle=4, burst=2).json()
    assert (stored["cycle"], stored["burst"]) == (4, 2)
    assert api.measurement(stored["id"])["burst"] == 2
    assert_problem(patch(api, stored["id"], cycle=None), 422, "burst_without_cycle")
    assert api.measurement(stored["id"])["cycle"] == 4
    assert patch(api, stored["id"], cycle=None, burst=None).json()["burst"] == 1


def test_a_burst_of_one_is_the_default_and_needs_no_cycle(any_api: Any, grey_png: bytes) -> None:
    api = any_api
    session_id = api.make_session()
    said = api.put_image(session_id, grey_png, burst=1)
    assert (said.status_code, said.json()["cycle"], said.json()["burst"]) == (202, None, 1)
    form = api.client.post(
        f"/v1/sessions/{session_id}/images",
        data={"pose_id": "P2", "burst": "1"},
        files={"image": ("a.png", grey_png)},
    )
    silent = api.put_image(session_id, grey_png, pose_id="P3").json()
    ids = [said.json()["id"], form.json()["id"], silent["id"]]
    assert [api.measurement(one)["burst"] for one in ids] == [1, 1, 1]
    assert patch(api, ids[0], burst=1).json() == api.measurement(ids[0])
    with api.installation.database.read() as records:
        assert set(records.scalars(sa.select(Measurement.burst))) == {
            None
        }  # what identifies the inputs is the same


def test_only_what_exists_is_corrected(api: Any) -> None:
    assert_problem(patch(api, f"mea_{'0' * 26}", cycle=1), 404, "measurement_not_found")
    assert_problem(patch(api, "x", cycle=1), 404, "measurement_not_found")


def test_the_audit_trail_names_all_that_changed(any_api: Any, pair: tuple[str, list[str]]) -> None:
    api, (_, ids) = any_api, pair
    patch(api, ids[1], pose_id="P2")
    patch(api, ids[1], excluded={"reason": "x"})
    found = api.client.get("/v1/audit", params={"object_id": ids[1]}).json()["items"]
    of_change = [entry["object_ids"] for entry in found if entry["action"] == "update_measurement"]
    assert of_change == [[ids[1], ids[0]], [ids[1]]]
