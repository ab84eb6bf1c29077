"""What a report was made from, after corrections: named in words, and loaded as it was."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from app.analyses.inputs.session_loader import load_session
from app.analyses.inputs.snapshot_reader import read_snapshot
from app.analyses.reporting.changes import changed_inputs
from app.analyses.reporting.inputs import read_inputs
from app.analyses.reporting.recomputation import ReportedSession, load_reported
from app.records.codec import content_hash
from app.records.tables import Measurement, Result
from tests.support.sessions.stored_sessions import Store, new_session, shoot

IMAGE = {
    "measurement_id": "mea_1",
    "pose_id": "P1",
    "cycle": 3,
    "target_id": "tgt_1",
    "focus_group": "default",
    "failure_code": None,
    "failure_detail": None,
    "content_sha256": "a",
    "computed_by": "0.1.0",
}
EXCLUDED = {"failure_code": "excluded_by_user", "content_sha256": None}
SESSION = {"id": "ses_1", "name": "Cell 7", "conditions": {"load_kg": 5.0}}


def inputs(image: dict[str, Any] | None = None, **fields: Any) -> dict[str, Any]:
    nothing: dict[str, Any] = {
        "session": SESSION,
        "robot": None,
        "targets": [],
        "poses": [],
        "measured_poses": [],
    }
    return {**nothing, "images": [] if image is None else [image], **fields}


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ({}, {**EXCLUDED, "failure_detail": "hand in view"}, "excluded: hand in view"),
        (
            {**EXCLUDED, "failure_detail": "hand in view"},
            {},
            "included again; it was excluded: hand in view",
        ),
        ({}, {"pose_id": "P2", "burst": 2}, "moved from P1 cycle 3 to P2 cycle 3 burst 2"),
        ({}, {"cycle": None}, "moved from P1 cycle 3 to P1 without a cycle"),
        (
            {},
            {"focus_group": "far", **EXCLUDED, "failure_detail": "blurred"},
            "excluded: blurred; focus group from default to far",
        ),
        ({}, {"content_sha256": "b"}, "measured again by 0.1.0, to other grid points"),
        ({}, {"computed_by": "0.2.0"}, "measured again by 0.2.0, to the same grid points"),
        (
            {},
            {"content_sha256": content_hash(None, None), "failure_code": "target_not_found"},
            "measured again by 0.1.0, to no grid points; refused: target_not_found",
        ),
        (
            {},
            {"failure_code": "target_not_in_session", "content_sha256": None, "target_id": None},
            "its target is no target of the session any more",
        ),
    ],
)
def test_what_became_of_an_image_is_said_in_words(
    before: dict[str, Any], after: dict[str, Any], words: str
) -> None:
    found = list(changed_inputs(inputs({**IMAGE, **before}), inputs({**IMAGE, **after}), {}))
    assert found == [{"noun": "image", "name": "mea_1", "detail": words}]


def test_values_that_changed_are_named_and_fields_that_a_report_does_not_state_are_not() -> None:
    session = {**SESSION, "name": "Cell 8", "conditions": {"load_kg": 5.0, "temperature_c": 21.0}}
    image = {**IMAGE, "captured_at": "2026-11-28T00:00:00Z"}
    (found,) = changed_inputs(inputs(IMAGE), inputs(image, session=session), {})
    assert found["detail"] == (
        "changed: name from Cell 7 to Cell 8; conditions.temperature_c from nothing to 21.0"
    )


def test_an_image_without_a_result_is_deleted_or_waits() -> None:
    def change(statuses: dict[str, str]) -> str:
        (found,) = changed_inputs(inputs(IMAGE), inputs(), statuses)
        return str(found["detail"])

    assert change({}) == "deleted"
    assert change({"mea_1": "queued"}) == "without a result now: queued"


def read(api: Any, session: str) -> tuple[Any, dict[str, Any], Any]:
    """The session's snapshot, its inputs as a report's JSON states them, and its data."""
    with api.installation.database.read() as records:
        snapshot = read_snapshot(records, session)
        stated = json.loads(json.dumps(read_inputs(records, snapshot, with_rms=False)))
        return snapshot, stated, load_session(records, snapshot)


def reported(api: Any, stated: dict[str, Any], subject: Any) -> ReportedSession:
    with api.installation.database.read() as records:
        now = read_inputs(records, read_snapshot(records, stated["session"]["id"]), with_rms=False)
        return load_reported(records, {"inputs": stated, "subject": subject, "source": "images"}, now)


def test_a_corrected_session_is_loaded_as_its_report_states_it(api: Any, store: Store) -> None:
    session = new_session(api)
    ids = store(api, session, shoot(poses=1, cycles=4))
    before, stated, data = read(api, session)
    for place, body in enumerate(
        ({"pose_id": "P2"}, {"excluded": {"reason": "one"}}, {"focus_group": "far"})
    ):
        assert api.client.patch(f"/v1/measurements/{ids[place]}", json=body).status_code == 200
    store(api, session, shoot(seed=2, poses=1, cycles=1))
    found = reported(api, stated, before.subject)
    assert found.loaded is not None
    assert found.loaded.snapshot == before
    assert (found.unavailable, found.current_values) == ([], [])
    ((views,), (views_before,)) = found.loaded.data.views, data.views
    assert np.array_equal(views.images, views_before.images)
    assert np.array_equal(views.views.points_px, views_before.views.points_px)
    assert found.loaded.data.taken_h == data.taken_h
    assert api.client.patch(f"/v1/measurements/{ids[1]}", json={"excluded": None}).status_code == 200
    assert reported(api, stated, before.subject).loaded is not None


def test_what_an_earlier_report_does_not_state_is_as_it_is_now(api: Any, store: Store) -> None:
    session = new_session(api)
    ids = store(api, session, shoot(poses=1, cycles=2))
    api.client.patch(f"/v1/measurements/{ids[0]}", json={"excluded": {"reason": "one"}})
    before, stated, _ = read(api, session)
    for image in stated["images"]:
        for name in (
            "failure_detail",
            "labelling",
            "captured_at",
            "received_at",
            "image_width_px",
            "image_height_px",
        ):
            del image[name]
    api.client.patch(f"/v1/measurements/{ids[1]}", json={"excluded": {"reason": "two"}})
    found = reported(api, stated, before.subject)
    assert found.loaded is not None
    assert found.loaded.snapshot == before
    assert found.current_values == ["image.failure_detail", "image.labelling"]


def test_images_whose_grid_points_are_gone_or_replaced_are_named(api: Any, store: Store) -> None:
    session = new_session(api)
    ids = store(api, session, shoot(poses=1, cycles=4))
    before, stated, _ = read(api, session)
    with api.installation.database.write() as records:
        records.get_one(Result, ids[0]).content_sha256 = "0" * 64
        records.get_one(Result, ids[1]).content_sha256 = content_hash(None, None)
        records.delete(records.get_one(Measurement, ids[2]))
    found = reported(api, stated, before.subject)
    assert found.loaded is None
    assert [(one["name"], one["detail"]) for one in found.unavailable] == [
        (ids[0], "measured again, to other grid points"),
        (ids[1], "measured again, to no grid points"),
        (ids[2], "deleted"),
    ]


def test_a_camera_mount_that_was_changed_is_named_though_one_on_the_robot_is_not_stated() -> None:
    (change,) = changed_inputs(inputs(), inputs(session={**SESSION, "camera_mount": "fixed"}), {})
    assert change["detail"] == "changed: camera mount from robot to fixed"
    assert list(changed_inputs(inputs(), inputs(session={**SESSION, "camera_mount": "robot"}), {})) == []
