"""Bursts over HTTP: images that are stated to be of one stop count as one cycle, and their scatter is answered."""

from __future__ import annotations

from typing import Any

import pytest

from tests.support.sessions.repeatability import table
from tests.support.sessions.stored_sessions import Store, new_session, shoot

STOPS = 7


@pytest.mark.slow
def test_images_of_a_burst_are_one_cycle(api: Any, store: Store) -> None:
    shots = shoot(cycles=2 * STOPS)
    session = new_session(api)
    ids = store(api, session, shots)
    apart = table(api, session)
    assert apart["bursts"] is None
    assert {(row["cycles"], row["within_stops"]) for row in apart["poses"]} == {(2 * STOPS, None)}
    for shot, measurement_id in zip(shots, ids, strict=True):
        assert shot.cycle is not None
        stop, place = divmod(shot.cycle - 1, 2)
        changes = {"cycle": stop + 1, "burst": place + 1}
        assert api.client.patch(f"/v1/measurements/{measurement_id}", json=changes).status_code == 200
    found = table(api, session)
    assert found["inputs_sha256"] != apart["inputs_sha256"]
    poses = len(found["poses"])
    assert (found["bursts"]["stop_count"], found["bursts"]["image_count"]) == (
        poses * STOPS,
        2 * poses * STOPS,
    )
    for row in found["poses"]:
        assert row["cycles"] == STOPS
        assert len(row["measurement_ids"]) == 2 * STOPS
        assert row["within_stops"]["degrees_of_freedom"] == STOPS
        assert row["within_stops"]["noise_floor"]["rp_l_mm"] > 0.0
    # Images of one "stop" here are visits of a robot that scatters: the model's noise is found to be too small.
    assert found["bursts"]["of_position"]["ratio_to_model"] > 1.0
    assert found["bursts"]["of_position"]["p_value"] < 0.01
    assert found["bursts"]["of_position"]["added"]
    assert [w["code"] for w in found["warnings"]].count("burst_scatter_above_model") == 1
    assert all(row["verdict"] != "robot" for row in found["poses"])
