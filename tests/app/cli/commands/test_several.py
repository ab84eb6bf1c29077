"""Commands that take several resources do what they can, and name those that are refused."""

from __future__ import annotations

from typing import Any

from tests.support.command_line import gridpose


def test_one_unknown_measurement_does_not_keep_the_others(served: Any, grey_png: bytes) -> None:
    session = served.make_session()
    first, second = (served.put_image(session, grey_png, pose).json()["id"] for pose in ("P1", "P2"))
    ids = (first, "mea_unknown", second)
    refused = gridpose(served, "measurements", "exclude", *ids, "--reason", "moved", code=1)
    assert "mea_unknown: " in refused.stderr
    assert "gridpose measurements list" in refused.stderr
    assert [served.measurement(one)["excluded"]["reason"] for one in (first, second)] == ["moved"] * 2
    gridpose(served, "measurements", "include", *ids, code=1)
    assert [served.measurement(one)["excluded"] for one in (first, second)] == [None, None]
    gridpose(served, "measurements", "retry", *ids, code=1)
    gridpose(served, "measurements", "delete", *ids, code=1)
    assert served.measurements(session) == []


def test_a_failure_of_all_is_said_once(served: Any) -> None:
    refused = gridpose(served, "robots", "delete", "a", "b", "--api-key", "gp_none", code=1)
    assert refused.stderr.count("not_authenticated") == 1


def test_targets_are_deleted_by_name_or_id(served: Any) -> None:
    named, by_id = served.make_target(name="glass plate"), served.make_target(name="other")
    deleted = gridpose(served, "targets", "delete", "glass plate", "none", by_id, code=1)
    assert "none: " in deleted.stderr
    assert "target_not_found" in deleted.stderr
    assert [line.split()[0] for line in deleted.stdout.splitlines() if "deleted" in line] == [named, by_id]
    assert served.client.get(f"/v1/targets/{named}").status_code == 404
