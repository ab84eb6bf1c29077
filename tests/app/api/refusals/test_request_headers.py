"""Headers that cannot be honoured are refused: conditions on entity tags, and compressed bodies."""

from __future__ import annotations

import gzip
from typing import Any

import pytest

from tests.support.service.service import OCTETS, assert_problem, image_address


def test_a_change_on_condition_of_a_tag_is_not_made(api: Any) -> None:
    address = f"/v1/targets/{api.make_target()}"
    before = api.client.get(address).json()
    refused = api.client.patch(address, json={"name": "new"}, headers={"If-Match": '"1"'})
    assert assert_problem(refused, 412, "precondition_failed")["advice"]
    assert api.client.get(address, headers={"If-Match": '"1"'}).json() == before
    missing = f"/v1/targets/tgt_{'0' * 26}"
    assert_problem(api.client.delete(missing, headers={"If-Match": '"1"'}), 404)
    assert api.client.patch(address, json={"name": "new"}, headers={"If-Match": "*"}).status_code == 200


@pytest.mark.parametrize("encoding", ["gzip", "br"])
def test_a_compressed_body_is_not_read(api: Any, grey_png: bytes, encoding: str) -> None:
    headers = {"Content-Encoding": encoding, "Content-Type": "application/json"}
    refused = api.client.post("/v1/targets", content=gzip.compress(b"{}"), headers=headers)
    assert assert_problem(refused, 415, "content_encoding_unsupported")["advice"]
    assert refused.headers["accept-encoding"] == "identity"
    address = image_address(api.make_session(), grey_png)
    sent = api.client.put(address, content=grey_png, headers={**OCTETS, "Content-Encoding": encoding})
    assert_problem(sent, 415, "content_encoding_unsupported")
    plain = {**OCTETS, "Content-Encoding": "identity"}
    assert api.client.put(address, content=grey_png, headers=plain).status_code == 202
