"""Lists of resources: their order, pages, cursors and filters."""

from __future__ import annotations

from typing import Any


def test_lists_run_from_oldest_to_newest_by_pages(any_api: Any) -> None:
    made = [any_api.make_target(name=f"t{n}") for n in range(7)]
    seen, cursor, sizes = [], None, []
    while True:
        query = {"limit": 3} if cursor is None else {"limit": 3, "cursor": cursor}
        page = any_api.client.get("/v1/targets", params=query).json()
        seen += [item["id"] for item in page["items"]]
        sizes.append(len(page["items"]))
        cursor = page["next_cursor"]
        if cursor is None:
            break
    assert seen == made
    assert sizes == [3, 3, 1]
    assert any_api.client.get("/v1/targets", params={"limit": 7}).json()["next_cursor"] is None


def test_a_cursor_is_of_one_list_with_its_filters(any_api: Any) -> None:
    targets = [any_api.make_target(name="t") for _ in range(3)]
    sessions = [any_api.make_session(targets[0]) for _ in range(2)]
    for session in sessions:
        poses = [{"pose_id": f"P{n}"} for n in range(3)]
        assert any_api.client.post(f"/v1/sessions/{session}/poses", json=poses).status_code == 200

    def page(path: str, **query: object) -> Any:
        return any_api.client.get(path, params={"limit": 1, **query})

    of_targets = page("/v1/targets").json()["next_cursor"]
    of_poses = page(f"/v1/sessions/{sessions[0]}/poses").json()["next_cursor"]
    others = [
        (f"/v1/sessions/{sessions[1]}/poses", {"cursor": of_poses}),
        ("/v1/targets", {"cursor": of_poses}),
        ("/v1/sessions", {"cursor": of_targets}),
        ("/v1/targets", {"cursor": of_targets, "name": "t"}),
    ]
    for path, query in others:
        response = page(path, **query)
        assert (response.status_code, response.json()["code"]) == (422, "invalid_cursor")
    assert page("/v1/targets", cursor=of_targets).json()["items"][0]["id"] == targets[1]
    # The row that a cursor names may be gone.
    assert any_api.client.delete(f"/v1/targets/{targets[1]}").status_code == 204
    following = page("/v1/targets", cursor=page("/v1/targets").json()["next_cursor"])
    assert following.json()["items"][0]["id"] == targets[2]


def test_lists_are_asked_for_a_name(any_api: Any) -> None:
    joints = [{"a_mm": 100.0, "alpha_deg": 90.0, "d_mm": 0.0}]
    for name in ("Zelle 7", "Zelle 7", "zelle 7", "Zelle"):
        target = any_api.make_target(name=name)
        any_api.make_session(target, name=name)
        assert any_api.client.post("/v1/robots", json={"name": name, "joints": joints}).status_code == 201
    for path in ("/v1/targets", "/v1/sessions", "/v1/robots"):
        found = any_api.client.get(path, params={"name": "Zelle 7", "limit": 1}).json()
        following = {"name": "Zelle 7", "cursor": found["next_cursor"]}
        items = found["items"] + any_api.client.get(path, params=following).json()["items"]
        assert [item["name"] for item in items] == ["Zelle 7"] * 2
        assert items[0]["id"] != items[1]["id"]
        assert any_api.client.get(path, params={"name": "%"}).json()["items"] == []
        assert any_api.client.get(path, params={"name": "x" * 201}).status_code == 422


def test_a_list_gives_fifty_items_unless_asked_otherwise(api: Any) -> None:
    address = f"/v1/sessions/{api.make_session()}/poses"
    api.client.post(address, json=[{"pose_id": f"P{n:03}"} for n in range(60)])
    assert len(api.client.get(address).json()["items"]) == 50
    assert len(api.client.get(address, params={"limit": 500}).json()["items"]) == 60
