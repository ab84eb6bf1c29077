"""What every analysis says of itself: subject, pending, excluded measurements, warnings; one shape everywhere."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from core.geometry.se3 import invert
from tests.support.sessions.robot_session import ANALYSES, FORMULA, RobotSession
from tests.support.sessions.stored_sessions import (
    Shot,
    Store,
    draw_board_pose,
    look,
    new_session,
    shoot,
    with_fields,
)

HEAD = {"session_id", "subject", "inputs_sha256", "core_version", "pending", "excluded", "warnings"}


@pytest.mark.slow
@pytest.mark.parametrize("analysis", ANALYSES)
def test_every_analysis_names_its_subject_and_what_does_not_count(
    robot_session: RobotSession, analysis: str
) -> None:
    document = robot_session.get(analysis).json()
    assert document.keys() >= HEAD
    subject = document["subject"]
    stored = robot_session.api.client.get(f"/v1/sessions/{robot_session.id}").json()
    assert subject["session"] == {"id": robot_session.id, "name": stored["name"]}
    assert subject["robot"] == {"id": robot_session.robot_id, "name": "KR5"}
    assert [target["id"] for target in subject["targets"]] == stored["target_ids"]
    assert (subject["first_captured_at"], subject["last_captured_at"]) == (None, None)
    (excluded,) = [
        e for e in document["excluded"] if e["measurement_id"] == robot_session.measurement_ids[-1]
    ]
    assert (excluded["filename"], excluded["code"]) == (FORMULA, "excluded_by_user")
    keys = {"measurement_id", "measured_pose_id", "filename", "code", "detail"}
    assert all(set(e) == keys for e in document["excluded"])
    assert len({e["measurement_id"] for e in document["excluded"]}) == len(document["excluded"])
    assert all(set(w) == {"code", "detail", "advice"} for w in document["warnings"])


@pytest.mark.slow
def test_images_that_one_image_estimators_refuse_are_excluded(api: Any, store: Store) -> None:
    rng = np.random.default_rng(5)
    flat = []
    for i in range(3):
        T = draw_board_pose(rng, 1.0)
        flat.append(Shot(f"F{i}", 1, look(rng, T), invert(T), {"filename": f"flat{i}.png"}))
    session = new_session(api)
    ids = store(api, session, [*shoot(cycles=2), *flat])
    for analysis in ("intrinsics", "camera-poses", "repeatability"):
        address = f"/v1/sessions/{session}/{analysis}"
        assert api.client.get(address).json()["excluded"] == []
        alone = api.client.get(address, params={"estimator": "per_image"}).json()["excluded"]
        assert [(e["measurement_id"], e["filename"], e["code"]) for e in alone] == [
            (name, f"flat{i}.png", "focal_not_observable") for i, name in enumerate(ids[-3:])
        ]


def test_times_are_those_of_the_images_and_a_new_name_gives_a_new_answer(api: Any, store: Store) -> None:
    session = new_session(api)
    shots = shoot(cycles=2)
    first, last = datetime(2026, 1, 31, 12, tzinfo=UTC), datetime(2026, 1, 31, 13, 30, tzinfo=UTC)
    timed = [
        *with_fields(shots[:1], captured_at=last),
        *with_fields(shots[1:2], captured_at=first),
        *shots[2:],
    ]
    store(api, session, timed)
    address = f"/v1/sessions/{session}/intrinsics"
    before = api.client.get(address)
    subject = before.json()["subject"]
    assert subject["robot"] is None
    assert subject["first_captured_at"] == "2026-01-31T12:00:00Z"
    assert subject["last_captured_at"] == "2026-01-31T13:30:00Z"
    tag = {"If-None-Match": before.headers["ETag"]}
    assert api.client.get(address, headers=tag).status_code == 304
    assert api.client.patch(f"/v1/sessions/{session}", json={"name": "Cell 4"}).status_code == 200
    conditions = {"conditions": {"speed_percent": 50}}
    assert api.client.patch(f"/v1/sessions/{session}", json=conditions).status_code == 200
    after = api.client.get(address, headers=tag)
    assert (after.status_code, after.json()["subject"]["session"]["name"]) == (200, "Cell 4")
    assert subject["conditions"] is None
    assert after.json()["subject"]["conditions"]["speed_percent"] == 50.0
    assert after.json()["inputs_sha256"] == before.json()["inputs_sha256"]
