"""What the story's application refuses: each status that the document has, and what there is not."""

from __future__ import annotations

import re
from collections.abc import Iterable

from tests.support.contract.contract import Operation
from tests.support.service.service import OCTETS, Api, image_address

_UNKNOWN = {"pose_id": "P1", "sha256": "0" * 64}


def refusals(api: Api) -> None:
    """Make one refusal of each status that the document has, but 429, 503 and 507."""
    client, target_id = api.client, api.make_target()
    api.make_session(target_id)
    read = api.key("read")
    sent = {"name": "board", "kind": "chessboard", "columns": 9, "rows": 6, "pitch_mm": -25.0}
    for response, status in (
        (client.get("/v1/targets", headers={"Authorization": "Bearer gp_unknown"}), 401),
        (client.post("/v1/targets", json=sent, headers=read), 403),
        (client.get("/v1/targets/tgt_unknown"), 404),
        (client.delete(f"/v1/targets/{target_id}"), 409),
        (client.patch(f"/v1/targets/{target_id}", json={"name": "b"}, headers={"If-Match": '"1"'}), 412),
        (
            client.post(
                "/v1/targets", content=b" " * (2 << 20), headers={"Content-Type": "application/json"}
            ),
            413,
        ),
        (client.post("/v1/targets", content=b"name: board", headers={"Content-Type": "text/yaml"}), 415),
        (client.post("/v1/targets", json=sent), 422),
    ):
        assert response.status_code == status, response.text


def ask_for_nothing(api: Api, operations: Iterable[Operation]) -> None:
    """Name what there is not in the path of each operation (404), and a parameter that there is not elsewhere (422)."""
    for operation in operations:
        if operation.content.get("security") == []:
            continue
        names = re.findall(r"\{(\w+)\}", operation.path)
        path = operation.path.format(**{name: _UNKNOWN.get(name, f"{name[:3]}_unknown") for name in names})
        asked = {} if names else {"colour": "red"}
        response = api.client.request(operation.method, path, params=asked)
        # What is sent to a key is looked at before the key.
        expected = (404, 415) if names == ["key_id"] else (404,) if names else (422,)
        assert response.status_code in expected, f"{operation.operation_id}: {response.text}"


def over_quota(api: Api, image: bytes) -> None:
    """Send more than a key may (429)."""
    session_id = api.make_session()
    headers = {**OCTETS, **api.key("upload", bytes_per_day=10)}
    response = api.client.put(image_address(session_id, image), content=image, headers=headers)
    assert response.status_code == 429, response.text
