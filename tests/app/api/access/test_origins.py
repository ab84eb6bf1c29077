"""Without keys, no page of another host reaches the service: neither by DNS rebinding nor straight."""

from __future__ import annotations

from typing import Any

import pytest

from app.api.middleware.loopback import is_loopback_host

FOREIGN_HOSTS = (
    "evil.example",
    "evil.example:8000",
    "127.0.0.1.evil.example",
    "localhost.evil.example",
    "localhost:8000@evil.example",
    "192.168.1.5:8000",
    "127.1",
    "0.0.0.0",
    "[::2]",
    "[::1",
    "",
)
FOREIGN_ORIGINS = (
    {"Origin": "http://evil.example"},
    {"Origin": "null"},
    {"Origin": "http://localhost:3000"},
    {"Origin": "http://localhost.evil.example"},
    {"Sec-Fetch-Site": "cross-site"},
)


def addresses(api: Any) -> list[tuple[str, str]]:
    paths = api.client.app.openapi()["paths"]
    named = [(method.upper(), path) for path, item in paths.items() for method in item]
    return [
        *named,
        ("GET", "/docs"),
        ("GET", "/docs/start.js"),
        ("GET", "/openapi.json"),
        ("GET", "/v1/none"),
    ]


@pytest.fixture
def open_service(open_api: Any) -> Any:
    with open_api(auth="off") as running:
        running.client.headers.pop("Authorization")
        yield running


@pytest.mark.slow
def test_every_route_refuses_a_foreign_host_and_a_foreign_origin(open_service: Any) -> None:
    for method, path in addresses(open_service):
        for headers, code in (
            ({"Host": "evil.example:8000"}, "foreign_host"),
            ({"Host": "evil.example", "Origin": "http://evil.example"}, "foreign_host"),
            *((origin, "foreign_origin") for origin in FOREIGN_ORIGINS),
        ):
            response = open_service.client.request(method, path, headers=headers)
            assert (response.status_code, response.json()["code"]) == (403, code), (method, path, headers)
    assert not [key for key in open_service.client.get("/v1/keys").json()["items"] if key["name"] == "evil"]


def test_a_rebound_page_makes_no_key(open_service: Any) -> None:
    before = open_service.client.get("/v1/keys").json()["items"]
    headers = {"Host": "evil.example:8000", "Origin": "http://evil.example:8000"}
    body = {"name": "evil", "scope": "admin"}
    assert open_service.client.post("/v1/keys", json=body, headers=headers).status_code == 403
    assert open_service.client.get("/v1/keys").json()["items"] == before


@pytest.mark.parametrize("host", FOREIGN_HOSTS)
def test_no_other_name_is_one_of_this_machine(host: str) -> None:
    assert not is_loopback_host(host)


@pytest.mark.parametrize(
    "host", ["localhost", "LOCALHOST:80", "127.0.0.1", "127.8.9.1:8000", "[::1]", "[::1]:1"]
)
def test_its_own_pages_work_by_every_name_of_the_machine(open_service: Any, host: str) -> None:
    headers = {"Host": host, "Origin": f"http://{host.lower()}", "Sec-Fetch-Site": "same-origin"}
    assert open_service.client.get("/v1/targets", headers=headers).status_code == 200
    assert (
        open_service.client.get("/docs", headers={"Host": host, "Sec-Fetch-Site": "none"}).status_code == 200
    )


def test_two_hosts_are_refused(open_service: Any) -> None:
    headers = [("Host", "localhost"), ("Host", "evil.example")]
    assert open_service.client.get("/v1/targets", headers=headers).status_code == 403


def test_with_keys_any_name_of_the_server_will_do(api: Any) -> None:
    headers = {"Host": "measuring-pc:8000", "Origin": "https://elsewhere.example"}
    assert api.client.get("/v1/targets", headers=headers).status_code == 200
