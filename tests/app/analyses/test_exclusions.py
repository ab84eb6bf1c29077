"""Measurements that a user excludes: not in the figures, listed with the reason, and another hash of the inputs."""

from __future__ import annotations

from typing import Any

import pytest

from tests.support.sessions.stored_sessions import Store, body, new_session, shoot


@pytest.mark.slow
def test_an_excluded_measurement_is_listed_and_counts_nowhere(api: Any, store: Store) -> None:
    shots = shoot(cycles=5)
    session, without = new_session(api), new_session(api)
    ids = store(api, session, shots)
    store(api, without, shots[1:])
    address = f"/v1/sessions/{session}/repeatability"
    before = body(api.client.get(address))
    excluded = {"excluded": {"reason": "The arm was touched."}}
    assert api.client.patch(f"/v1/measurements/{ids[0]}", json=excluded).status_code == 200
    after = body(api.client.get(address))
    listed = [entry for pose in after["poses"] for entry in pose["excluded"]]
    expected = (ids[0], "excluded_by_user", "The arm was touched.")
    assert expected in [(entry["measurement_id"], entry["code"], entry["detail"]) for entry in listed]
    assert after["inputs_sha256"] != before["inputs_sha256"]
    others = body(api.client.get(f"/v1/sessions/{without}/repeatability"))
    assert _figures(after["poses"]) == _figures(others["poses"])
    assert api.client.patch(f"/v1/measurements/{ids[0]}", json={"excluded": None}).status_code == 200
    assert body(api.client.get(address)) == before, "as if nothing had been"


@pytest.mark.slow
def test_every_correction_gives_other_inputs(api: Any, store: Store) -> None:
    session = new_session(api)
    first, *_ = store(api, session, shoot(cycles=3))
    seen = set()
    for change in (
        {},
        {"cycle": 9},
        {"burst": 2},
        {"pose_id": "P2"},
        {"joint_angles_deg": [1.0]},
        {"excluded": {"reason": "one"}},
        {"excluded": {"reason": "another"}},
    ):
        assert api.client.patch(f"/v1/measurements/{first}", json=change).status_code == 200
        answer = api.client.get(f"/v1/sessions/{session}/repeatability")
        seen.add((answer.json()["inputs_sha256"], answer.headers["etag"]))
    assert len({inputs for inputs, _ in seen}) == len({etag for _, etag in seen}) == 7


def _figures(poses: list[dict[str, Any]]) -> list[Any]:
    """What is computed at each pose, without the ids of its measurements, which differ between sessions."""
    return [[pose[name] for name in ("pose_id", "mean", "repeatability", "interval")] for pose in poses]
