"""Quotas: how many bytes a key may send in a day."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta, tzinfo
from typing import Any, Self

import httpx2
import numpy as np
import pytest
import sqlalchemy as sa

from app.blobs.local import StagedBlob
from app.client import ClientError, ServiceClient
from app.errors import QuotaExceeded
from app.records.activity import Activity, acting
from app.records.tables import ApiKey
from app.services.measurements import quota
from app.services.measurements.quota import count_upload, day_of
from tests.support.image.images import encode


class Noon(datetime):
    """A clock that stands at noon: no test here begins on one day and ends on the next."""

    @classmethod
    def now(cls, tz: tzinfo | None = None) -> Self:
        return super().now(tz).replace(hour=12, minute=0, second=0, microsecond=0)


@pytest.fixture(autouse=True)
def noon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quota, "datetime", Noon)


def images(count: int) -> list[bytes]:
    return [encode(".png", np.full((8, 8), number, np.uint8)) for number in range(count)]


def use(api: Any, made: dict[str, Any]) -> None:
    api.client.headers["Authorization"] = f"Bearer {made['key']}"


def make(api: Any, bytes_per_day: int) -> dict[str, Any]:
    body = {"name": "cell", "scope": "upload", "bytes_per_day": bytes_per_day}
    document: dict[str, Any] = api.client.post("/v1/keys", json=body).json()
    return document


def test_uploads_beyond_the_quota_wait_for_midnight(any_api: Any) -> None:
    api = any_api
    first, second, third = images(3)
    session_id = api.make_session()
    admin = api.client.headers["Authorization"]
    made = make(api, len(first) + len(second))
    use(api, made)
    assert api.put_image(session_id, first).status_code == 202
    assert api.put_image(session_id, second).status_code == 202
    for _ in range(2):
        refused = api.put_image(session_id, third)
        assert (refused.status_code, refused.json()["code"]) == (429, "quota_exceeded")
        assert "bytes_per_day" in refused.json()["advice"]
        assert abs(int(refused.headers["retry-after"]) - 12 * 3600) < 60, "midnight is twelve hours from noon"
    files = {"image": ("x.png", third, "image/png")}
    form = api.client.post(f"/v1/sessions/{session_id}/images", files=files, data={"pose_id": "P1"})
    assert form.status_code == 429
    assert api.put_image(session_id, second).status_code == 200, "what is here already does not count"

    api.client.headers["Authorization"] = admin
    address = f"/v1/keys/{made['id']}"
    assert api.client.get(address).json()["bytes_today"] == len(first) + len(second)
    assert api.put_image(session_id, third, "P9").status_code == 202, "other keys have quotas of their own"
    api.client.patch(address, json={"bytes_per_day": 10**9})
    use(api, made)
    assert api.put_image(session_id, third).status_code == 202


def test_a_form_beyond_the_quota_is_refused_before_it_is_received(
    any_api: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    api, received = any_api, []
    write = StagedBlob.write

    def note(staged: StagedBlob, piece: bytes) -> None:
        received.append(len(piece))
        write(staged, piece)

    def send(data: bytes) -> Any:
        files = {"image": ("x.png", data, "image/png")}
        return api.client.post(f"/v1/sessions/{session_id}/images", files=files, data={"pose_id": "P1"})

    monkeypatch.setattr(StagedBlob, "write", note)
    (image,) = images(1)
    session_id = api.make_session()
    use(api, make(api, len(image)))
    assert send(image).status_code == 202
    received.clear()
    refused = send(image + bytes(3_000_000))
    assert (refused.status_code, refused.json()["code"], received) == (429, "quota_exceeded", [])
    assert send(image).status_code == 200, "what is here already does not count"


def test_a_new_day_begins_at_zero_and_a_restart_does_not(open_api: Any) -> None:
    first, second, third = images(3)
    with open_api() as api:
        folder, session_id = api.installation.settings.data_dir, api.make_session()
        made = make(api, max(map(len, (first, second))))
        use(api, made)
        assert api.put_image(session_id, first).status_code == 202
    with open_api(folder) as api:
        use(api, made)
        assert api.put_image(session_id, second).status_code == 429
        with api.installation.database.write() as records:
            yesterday = day_of(Noon.now(UTC) - timedelta(days=1))
            records.execute(sa.update(ApiKey).where(ApiKey.id == made["id"]).values(quota_day=yesterday))
        assert api.put_image(session_id, second).status_code == 202
        assert api.put_image(session_id, third).status_code == 429


def test_uploads_at_the_same_time_do_not_exceed_it_together(any_api: Any) -> None:
    made = make(any_api, 10)
    database = any_api.installation.database

    def send(_: int) -> bool:
        activity = Activity(actor="key", action="put_image", key_id=made["id"], has_quota=True)
        try:
            with acting(activity), database.write_rows() as rows:
                count_upload(rows, 1)
        except QuotaExceeded:
            return False
        return True

    with ThreadPoolExecutor(8) as pool:
        assert sum(pool.map(send, range(40))) == 10
    assert any_api.client.get(f"/v1/keys/{made['id']}").json()["bytes_today"] == 10


def test_a_client_does_not_wait_for_midnight() -> None:
    asked = []

    def answer(request: httpx2.Request) -> httpx2.Response:
        asked.append(request)
        problem = {"code": "quota_exceeded", "detail": "full", "advice": "wait"}
        return httpx2.Response(429, json=problem, headers={"Retry-After": "40000"})

    with (
        ServiceClient("http://x", "k", transport=httpx2.MockTransport(answer)) as client,
        pytest.raises(ClientError) as caught,
    ):
        client.put_image("s", "P1", "0" * 64, b"x")
    assert (caught.value.code, len(asked)) == ("quota_exceeded", 1)
