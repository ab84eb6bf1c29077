"""Addresses, ids, pages and parameters that there are not: problems in our own words, in the contract's order."""

from __future__ import annotations

from typing import Any

import pytest

from tests.support.service.service import assert_problem


@pytest.mark.parametrize(
    "query",
    [
        {"limit": "0"},
        {"limit": "501"},
        {"limit": "-1"},
        {"limit": "ten"},
        {"limit": "1.0"},
        {"limit": "1_0"},
        {"limit": ""},
        {"limit": "9" * 5000},
        {"cursor": "nonsense"},
        {"cursor": "dGd0X25vbnNlbnNl"},
        {"cursor": "x" * 1000},
        {"cursor": "\x00"},
        {"cursor": "ä"},
        {"cursor": ""},
    ],
)
def test_a_wrong_page_is_refused(api: Any, query: dict[str, str]) -> None:
    session_id = api.make_session()
    for address in ("/v1/targets", "/v1/keys", f"/v1/sessions/{session_id}/measurements"):
        assert_problem(api.client.get(address, params=query), 422)


@pytest.mark.parametrize("query", [{"status": "done"}, {"pose_id": "a b"}, {"status": ""}])
def test_a_wrong_filter_is_refused(api: Any, query: dict[str, str]) -> None:
    assert_problem(api.client.get(f"/v1/sessions/{api.make_session()}/measurements", params=query), 422)


@pytest.mark.parametrize(
    ("method", "address"),
    [
        ("GET", "/v1/targets"),
        ("POST", "/v1/targets"),
        ("GET", "/v1/robots"),
        ("GET", "/v1/sessions"),
        ("GET", "/v1/sessions/{session_id}"),
        ("DELETE", "/v1/sessions/{session_id}"),
        ("GET", "/v1/sessions/{session_id}/measurements"),
        ("GET", "/v1/sessions/{session_id}/poses"),
        ("GET", "/v1/keys"),
        ("GET", "/v1/audit"),
    ],
)
def test_a_query_parameter_that_the_route_lacks_is_refused(api: Any, method: str, address: str) -> None:
    """A misspelt filter would answer another list than was asked for."""
    session_id = api.make_session()
    response = api.client.request(method, address.format(session_id=session_id), params={"stauts": "failed"})
    assert_problem(response, 422)
    assert response.json()["errors"] == [{"field": "stauts", "message": "is not known"}]
    assert api.client.get(f"/v1/sessions/{session_id}").status_code == 200


@pytest.mark.parametrize(
    "row_id",
    ["nope", "ses_", "%00", "a" * 10_000, "ses_01m7xzjvh9bd6327yq4f9a70vg", "..%2f..%2fetc", "ä", "%FF"],
)
def test_an_unknown_id_is_not_found_before_the_body_is_looked_at(any_api: Any, row_id: str) -> None:
    for method, address in (
        ("GET", f"/v1/targets/{row_id}"),
        ("GET", f"/v1/robots/{row_id}"),
        ("GET", f"/v1/sessions/{row_id}"),
        ("PATCH", f"/v1/sessions/{row_id}"),
        ("DELETE", f"/v1/sessions/{row_id}"),
        ("POST", f"/v1/sessions/{row_id}/reprocess"),
        ("DELETE", f"/v1/sessions/{row_id}/measured-poses?x=1"),
        ("DELETE", f"/v1/targets/{row_id}"),
        ("DELETE", f"/v1/robots/{row_id}"),
        ("PATCH", f"/v1/measurements/{row_id}"),
        ("DELETE", f"/v1/measurements/{row_id}"),
        ("PUT", f"/v1/sessions/{row_id}/poses/not a tag"),
        ("POST", f"/v1/sessions/{row_id}/poses"),
        ("POST", f"/v1/sessions/{row_id}/images/missing"),
        ("POST", f"/v1/sessions/{row_id}/images"),
        ("PUT", f"/v1/sessions/{row_id}/poses/P1/images/nohash"),
        ("GET", f"/v1/sessions/{row_id}/measurements?limit=zero"),
        ("GET", f"/v1/sessions/{row_id}/events"),
        ("GET", f"/v1/measurements/{row_id}"),
        ("GET", f"/v1/measurements/{row_id}/image"),
        ("GET", f"/v1/measurements/{row_id}/overlay"),
        ("GET", f"/v1/measurements/{row_id}/thumbnail"),
        ("POST", f"/v1/measurements/{row_id}/retry"),
        ("GET", f"/v1/keys/{row_id}"),
        ("DELETE", f"/v1/keys/{row_id}"),
    ):
        assert_problem(any_api.client.request(method, address, content=b"not json"), 404)


def test_unknown_addresses_and_methods_are_problems(api: Any) -> None:
    for address in (
        "/v1",
        "/v1/nothing",
        "/v1/targets/",
        "/v2/targets",
        "/docs/../app",
        "/docs/main.py",
    ):
        assert_problem(api.client.get(address), 404)
    response = api.client.put("/v1/targets", json={})
    assert_problem(response, 405, "method_not_allowed")
    assert response.headers["allow"] == "GET, HEAD, POST"
    assert_problem(api.client.request("BREW", "/v1/targets"), 405)
