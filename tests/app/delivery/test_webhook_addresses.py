"""Webhooks that are refused: addresses that nothing is sent to, and what is no webhook."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from app.delivery.posting import AddressRefused, Attempt, _examined_addresses, post
from tests.support.service.receiver import receiver
from tests.support.service.service import Api, assert_problem

WEBHOOK = {"name": "MES", "url": "https://plant.example/hook", "types": ["report.ready"]}


@pytest.mark.parametrize(
    "url",
    [
        "ftp://plant.example/",
        "plant.example/hook",
        "https://",
        "https://user:secret@plant.example/",
        "https://plant.example/#top",
        "https://plant.example:port/",
        "http://169.254.169.254/latest/meta-data",
        "http://[fe80::1]/",
        "http://[::ffff:169.254.169.254]/",
        "http://0.0.0.0/",
        "http://224.0.0.1/",
    ],
)
def test_addresses_that_nothing_is_sent_to_are_refused(api: Api, url: str) -> None:
    problem = assert_problem(
        api.client.post("/v1/webhooks", json={**WEBHOOK, "url": url}), 422, "invalid_request"
    )
    assert [error["field"] for error in problem["errors"]] == ["url"]


@pytest.mark.parametrize(
    "change", [{"types": []}, {"types": ["image.refused"]}, {"name": ""}, {"secret": "mine"}]
)
def test_what_is_no_webhook_is_refused(api: Api, change: dict[str, Any]) -> None:
    refused = api.client.post("/v1/webhooks", json={**WEBHOOK, **change})
    assert_problem(refused, 422, "invalid_request")


def resolved_to(addresses: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Let names stand for these addresses in the loop that runs."""

    async def resolved(*_arguments: Any, **_options: Any) -> list[Any]:
        return [(None, None, None, "", (address, 80)) for address in addresses]

    monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", resolved)


def test_a_name_that_stands_for_a_link_local_address_is_not_called(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was resolved is examined and called, whatever the name says the next time."""

    async def look_up(addresses: list[str]) -> list[str]:
        resolved_to(addresses, monkeypatch)
        return await _examined_addresses("plant.example", 80)

    assert asyncio.run(look_up(["10.0.0.5", "10.0.0.5"])) == ["10.0.0.5"]
    with pytest.raises(AddressRefused):
        asyncio.run(look_up(["10.0.0.5", "169.254.169.254"]))


def test_a_receiver_is_reached_by_the_second_of_its_addresses(monkeypatch: pytest.MonkeyPatch) -> None:
    """A name with an IPv6 address that nothing listens on, as `localhost` is, was never reached."""

    async def attempt(url: str) -> Attempt:
        resolved_to(["127.0.0.2", "127.0.0.1"], monkeypatch)
        return await post(url, b"secret", "dlv_1", {}, at_s=0)

    with receiver() as mes:
        assert asyncio.run(attempt(mes.url.replace("127.0.0.1", "plant.example"))) == Attempt(204, None)
        assert [headers["host"] for _, headers, _ in mes.received] == [
            mes.url.replace("http://127.0.0.1", "plant.example")
        ]
