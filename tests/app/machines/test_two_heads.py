"""Two services and a worker on one database and bucket act as one."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.errors import InstallationRefused
from app.services.installation.context import ServiceContext
from app.settings import Settings
from tests.support.environment.proxy import Proxy
from tests.support.image.images import small_image
from tests.support.service.service import Api, wait_until

pytestmark = [pytest.mark.postgres, pytest.mark.slow]


@pytest.fixture
def heads(set_environment: dict[str, str], open_api: Any, tmp_path: Path) -> Iterator[list[Api]]:
    """Two services with a data folder of their own each; the second also computes."""
    values = {
        "database_url": set_environment["GRIDPOSE_DATABASE_URL"],
        "blob_url": set_environment["GRIDPOSE_BLOB_URL"],
        "key_pepper": set_environment["GRIDPOSE_KEY_PEPPER"],
    }
    with ExitStack() as running:
        yield [
            running.enter_context(open_api(tmp_path / name, workers=workers, **values))
            for name, workers in (("one", 0), ("other", 1))
        ]


def test_what_one_head_takes_the_other_computes_and_serves(heads: list[Api], board_png: bytes) -> None:
    one, other = heads
    session_id = one.make_session()
    accepted = one.put_image(session_id, board_png)
    assert accepted.status_code == 202, accepted.text
    measurement_id = accepted.json()["id"]
    again = other.put_image(session_id, board_png)
    assert (again.status_code, again.json()["id"]) == (200, measurement_id), (
        "the same image is one measurement"
    )
    assert other.wait_for(measurement_id)["status"] == "succeeded"
    for head in heads:
        assert head.client.get(f"/v1/measurements/{measurement_id}/image").content == board_png
        assert head.client.get(f"/v1/measurements/{measurement_id}/overlay").status_code == 200
        assert head.client.get(f"/v1/measurements/{measurement_id}/thumbnail").status_code == 200

    # A key that one head revokes is no key for the other.
    key = one.key("read")
    listed = other.client.get("/v1/sessions", headers=key)
    assert listed.status_code == 200
    key_id = "_".join(key["Authorization"].removeprefix("Bearer ").split("_")[:2]).replace("gp_", "key_")
    assert one.client.delete(f"/v1/keys/{key_id}").status_code in (200, 204)
    assert other.client.get("/v1/sessions", headers=key).status_code == 401

    # Analyses are the same bytes from both.
    answers = [head.client.get(f"/v1/sessions/{session_id}/intrinsics") for head in heads]
    assert answers[0].status_code == answers[1].status_code
    assert answers[0].content == answers[1].content
    with other.installation.database.read() as records:
        assert records.scalar(sa.text("SELECT count(*) FROM analysis_answers")) == 1, (
            "computed by one of them"
        )

    # What one deletes is gone for both, and from the bucket.
    sha256 = accepted.json()["sha256"]
    assert one.client.delete(f"/v1/sessions/{session_id}").status_code == 204
    assert other.client.get(f"/v1/measurements/{measurement_id}").status_code == 404
    assert not other.installation.blobs.is_there(sha256)
    assert other.installation.blobs.thumbnails.read(sha256) is None


def test_uploads_and_deletions_of_the_same_image_leave_no_row_without_it(
    heads: list[Api], grey_png: bytes
) -> None:
    """One head deletes sessions that hold an image while the other stores that image in others."""
    one, other = heads
    deleted = [one.make_session() for _ in range(12)]
    for session_id in deleted:
        assert one.put_image(session_id, grey_png).status_code == 202
    kept = [other.make_session() for _ in range(12)]

    def delete() -> None:
        for session_id in deleted:
            assert one.client.delete(f"/v1/sessions/{session_id}").status_code == 204

    remover = threading.Thread(target=delete)
    remover.start()
    for session_id in kept:
        assert other.put_image(session_id, grey_png).status_code == 202
        other.client.delete(f"/v1/sessions/{session_id}") if session_id != kept[-1] else None
    remover.join()
    (measurement,) = other.measurements(kept[-1])
    assert other.client.get(f"/v1/measurements/{measurement['id']}/image").content == grey_png


def test_a_stream_hears_at_once_of_what_another_head_stores(heads: list[Api], grey_png: bytes) -> None:
    one, other = heads
    session_id = one.make_session()
    heard = threading.Event()

    def listen() -> None:
        connection = other.installation.database.driver_options()
        import psycopg

        with psycopg.connect(**connection, autocommit=True) as listener:
            listener.execute("LISTEN gridpose")
            listening.set()
            for notification in listener.notifies(timeout=120.0, stop_after=1):
                if notification.payload == session_id:
                    heard.set()

    listening = threading.Event()
    thread = threading.Thread(target=listen)
    thread.start()
    assert listening.wait(120.0)
    one.put_image(session_id, grey_png)
    thread.join()
    assert heard.is_set()
    assert other.service.news.is_listening


def test_settings_of_different_installations_are_refused(
    heads: list[Api], set_environment: dict[str, str], store: Any, tmp_path: Path
) -> None:
    url, bucket = set_environment["GRIDPOSE_DATABASE_URL"], set_environment["GRIDPOSE_BLOB_URL"]

    def refused(**values: Any) -> str:
        settings = Settings(
            **{
                "data_dir": tmp_path / "third",
                "database_url": url,
                "blob_url": bucket,
                "workers": 0,
                **values,
            }
        )
        with pytest.raises(InstallationRefused) as caught:
            ServiceContext.open(settings)
        return caught.value.code

    assert heads[0].put_image(heads[0].make_session(), small_image(1)).status_code == 202
    assert refused(blob_url=f"s3://{store.new_bucket()}/empty") == "originals_elsewhere"
    assert refused(key_pepper="1" * 64) == "pepper_changed"


def test_a_bucket_that_can_only_be_read_is_refused(
    set_environment: dict[str, str], monkeypatch: pytest.MonkeyPatch, machine: Path
) -> None:
    from app.blobs.objects import store_of

    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "reader")
    store_of.cache_clear()
    with pytest.raises(InstallationRefused) as caught:
        ServiceContext.open(Settings(data_dir=machine, workers=0))
    assert caught.value.code == "bucket_refused"
    store_of.cache_clear()


def test_a_worker_needs_neither_pepper_nor_folder(
    heads: list[Api], set_environment: dict[str, str], monkeypatch: pytest.MonkeyPatch, machine: Path
) -> None:
    monkeypatch.delenv("GRIDPOSE_KEY_PEPPER")
    worker = ServiceContext.open(Settings(data_dir=machine, workers=1), init=False, serves=False)
    assert worker.pepper == b""
    worker.close()
    assert not (machine / "key-pepper").exists()
    with pytest.raises(InstallationRefused) as caught:
        ServiceContext.open(Settings(data_dir=machine, workers=1))
    assert caught.value.code == "pepper_missing"


def test_a_head_is_not_ready_while_the_store_is_away(
    set_environment: dict[str, str],
    store: Any,
    open_api: Any,
    monkeypatch: pytest.MonkeyPatch,
    machine: Path,
) -> None:
    from app.blobs.objects import store_of

    values = {
        "database_url": set_environment["GRIDPOSE_DATABASE_URL"],
        "blob_url": set_environment["GRIDPOSE_BLOB_URL"],
        "key_pepper": set_environment["GRIDPOSE_KEY_PEPPER"],
    }
    with closing(Proxy(store.port)) as proxy, ExitStack() as opened:
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{proxy.port}")
        store_of.cache_clear()
        head = opened.enter_context(open_api(machine, workers=0, **values))
        ready = head.client.get("/readyz")
        assert ready.status_code == 200
        assert "bucket" in [check["name"] for check in ready.json()["checks"]]
        proxy.set("cut")
        wait_until(lambda: head.client.get("/readyz").status_code == 503, 120.0, "not ready")
        away = head.client.get("/readyz").json()
        assert away["code"] == "not_ready"
        assert [error["field"] for error in away["errors"]] == ["bucket"]
        proxy.set("pass")
        wait_until(lambda: head.client.get("/readyz").status_code == 200, 120.0, "ready again")
    store_of.cache_clear()


def test_images_wait_while_the_store_is_away(heads: list[Api], grey_png: bytes) -> None:
    """A worker that cannot read originals gives them back: no attempt counts, and no image fails."""
    _, other = heads
    session_id = other.make_session()
    blobs = other.installation.blobs
    (address,) = [blobs.address("0" * 64)]
    assert address.startswith("s3://")
    accepted = other.put_image(session_id, grey_png)
    measurement = other.wait_for(accepted.json()["id"])
    assert (measurement["attempts"], measurement["failure"]["code"]) == (1, "target_not_found")
    with other.installation.database.read() as records:
        wait_until(
            lambda: (
                records.scalar(sa.text("SELECT count(*) FROM procrastinate_jobs WHERE queue_name = 'images'"))
                == 0
            ),
            120.0,
            "no job is left",
        )
