"""Keys and scopes: who gets in, what they may do, and that nothing else is looked at before."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import pytest
from pydantic import ValidationError

from app.services.keys import create_key, find_key, revoke_key
from app.settings import Settings


@pytest.mark.parametrize(
    "header",
    [
        "",
        "Bearer",
        "Bearer ",
        "Bearer nonsense",
        "Basic dXNlcjpwYXNz",
        "Bearer gp_00000000000000000000000000_" + "0" * 64,
        "Bearer gp_" + "x" * 100_00,
        "Bearer gp_\u00e9",
    ],
)
def test_a_missing_or_wrong_key_is_401_whatever_else_is_wrong(api: Any, header: str) -> None:
    for method, address in (
        ("GET", "/v1/targets"),
        ("POST", "/v1/targets"),
        ("GET", "/v1/nothing"),
        ("DELETE", "/v1/sessions/none"),
        ("GET", "/metrics"),
    ):
        response = api.client.request(
            method, address, headers={"Authorization": header.encode("latin-1")}, content=b"{"
        )
        assert (response.status_code, response.json()["code"]) == (401, "not_authenticated")
        assert response.headers["www-authenticate"].startswith("Bearer")
        assert response.headers["content-type"] == "application/problem+json"


def test_some_addresses_need_no_key(api: Any) -> None:
    api.client.headers.pop("Authorization")
    for address in ("/livez", "/readyz", "/openapi.json", "/docs", "/docs/start.js"):
        assert api.client.get(address).status_code == 200


def test_a_key_made_over_http_works_until_it_is_revoked(any_api: Any) -> None:
    made = any_api.client.post("/v1/keys", json={"name": "cell 4", "scope": "read", "expires_in_days": 30})
    assert made.status_code == 201
    document = made.json()
    headers = {"Authorization": f"Bearer {document['key']}"}
    assert any_api.client.get("/v1/targets", headers=headers).status_code == 200

    listed = any_api.client.get("/v1/keys").json()["items"]
    assert document["id"] in [key["id"] for key in listed]
    assert all("key" not in key and "secret_hmac" not in key for key in listed)
    secret = document["key"].rpartition("_")[2]
    assert secret not in any_api.client.get("/v1/keys").text
    assert any_api.client.get(made.headers["location"]).json()["revoked_at"] is None

    assert any_api.client.delete(made.headers["location"]).status_code == 204
    assert any_api.client.delete(made.headers["location"]).status_code == 204
    assert any_api.client.get("/v1/targets", headers=headers).status_code == 401
    assert any_api.client.get(made.headers["location"]).json()["revoked_at"] is not None
    changed = any_api.client.patch(made.headers["location"], json={"name": "cell 5"})
    assert (changed.status_code, changed.json()["code"]) == (409, "key_revoked")
    revoked = {key["id"]: key["revoked_at"] for key in any_api.client.get("/v1/keys").json()["items"]}
    assert revoked[document["id"]] is not None


@pytest.mark.parametrize(
    "body",
    [
        {"name": "k"},
        {"name": "k", "scope": "root"},
        {"name": "", "scope": "read"},
        {"name": "k", "scope": "read", "expires_in_days": 0},
    ],
)
def test_a_wrong_key_request_is_refused(api: Any, body: dict[str, Any]) -> None:
    before = len(api.client.get("/v1/keys").json()["items"])
    assert api.client.post("/v1/keys", json=body).status_code == 422
    assert len(api.client.get("/v1/keys").json()["items"]) == before


def test_an_expired_key_is_no_key(api: Any) -> None:
    expired = create_key(api.installation, "old", "admin", expires_in=timedelta(seconds=-1))
    assert find_key(api.installation, expired.secret_key) is None
    valid = create_key(api.installation, "new", "admin", expires_in=timedelta(days=1))
    found = find_key(api.installation, valid.secret_key)
    assert found is not None
    assert found.id == valid.key.id
    revoke_key(api.installation, valid.key.id)
    assert find_key(api.installation, valid.secret_key) is None


def test_every_character_of_a_key_counts(api: Any) -> None:
    key = create_key(api.installation, "k", "admin").secret_key
    assert find_key(api.installation, key) is not None
    for position in range(len(key)):
        other = "1" if key[position] != "1" else "2"
        assert find_key(api.installation, key[:position] + other + key[position + 1 :]) is None
    assert find_key(api.installation, key + "\n") is None


def test_without_keys_everyone_may_do_everything(open_api: Any) -> None:
    with open_api(auth="off") as running:
        running.client.headers.pop("Authorization")
        assert running.client.get("/v1/keys").status_code == 200


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "example.com", ""])
def test_a_service_without_keys_must_listen_on_loopback_only(host: str) -> None:
    with pytest.raises(ValidationError, match="loopback"):
        Settings(auth="off", host=host)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.1.2.3", "::1", "localhost"])
def test_loopback_addresses_may_go_without_keys(host: str) -> None:
    assert Settings(auth="off", host=host).auth == "off"
