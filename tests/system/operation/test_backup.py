"""Backup and restore with the real commands, while the service takes uploads; and the way back to an older schema."""

from __future__ import annotations

import hashlib
import re
import sqlite3
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from tests.support.command_line import gridpose_here
from tests.support.environment.postgres import EITHER_DATABASE
from tests.support.image.images import small_image
from tests.support.service.service import gridpose, new_session, put, wait_until
from tests.support.service.uploads import finished_measurements

MakeService = Callable[..., ServiceProcess]

IMAGES = 12


@pytest.fixture(params=EITHER_DATABASE)
def database(request: pytest.FixtureRequest) -> dict[str, str]:
    """The environment of a service on either database."""
    if request.param == "sqlite":
        return {}
    return {"GRIDPOSE_DATABASE_URL": request.getfixturevalue("postgres_url")}


def emptied(database: dict[str, str]) -> None:
    """Make a PostgreSQL database empty again, as a new server's is."""
    if database:
        engine = sa.create_engine(database["GRIDPOSE_DATABASE_URL"])
        with engine.begin() as connection:
            connection.exec_driver_sql("DROP SCHEMA public CASCADE")
            connection.exec_driver_sql("CREATE SCHEMA public")
        engine.dispose()


def everything(client: ServiceClient, *, analysed: bool) -> dict[str, Any]:
    """Return all that the service shows of its sessions: every result, and points and images of the first."""
    shown: dict[str, Any] = {}
    for session in client.items("/v1/sessions"):
        shown[session["id"]] = session
        measurements = list(client.items(f"/v1/sessions/{session['id']}/measurements"))
        shown.update((found["id"], found) for found in measurements)
        for found in measurements[:IMAGES]:
            address = f"/v1/measurements/{found['id']}"
            shown[address] = client.get(f"{address}?include=points")
            shown[found["sha256"]] = hashlib.sha256(client.get_bytes(f"{address}/image")).hexdigest()
        if analysed:
            shown["intrinsics"] = client.get(f"/v1/sessions/{session['id']}/intrinsics")
            assert shown["intrinsics"]["inputs_sha256"]
    return shown


def test_what_is_restored_answers_as_what_was_backed_up(
    make_service: MakeService, database: dict[str, str], photo: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "backup"
    service = make_service(**database).start()
    key = service.admin_key
    with ServiceClient(service.url, key) as client:
        session_id = new_session(client)

        for number in range(1, 5):
            put(client, session_id, photo.with_name(f"left0{number}.jpg").read_bytes())
        ended = threading.Event()
        sent: list[int] = []

        def upload() -> None:
            with ServiceClient(service.url, key) as uploader:
                while not ended.is_set():
                    data = small_image(len(sent))
                    put(uploader, session_id, data, "P2")
                    sent.append(len(sent))
                    # Several during a backup, which takes a second and more; each is measured before the test goes on.
                    ended.wait(0.02 if len(sent) < IMAGES else 0.2)

        uploading = threading.Thread(target=upload)
        uploading.start()
        try:
            wait_until(lambda: len(sent) >= IMAGES, 120, "uploads go on")
            first = gridpose_here("backup", str(folder), "--data-dir", str(service.data_dir), **database)
            uploaded = len(sent)
            wait_until(lambda: len(sent) > uploaded, 120, "uploads go on after the backup")
        finally:
            ended.set()
            uploading.join(60)
        assert first.returncode == 0, first.stdout + first.stderr
        assert len(finished_measurements(client, session_id)) == 4 + len(sent)
        second = gridpose_here("backup", str(folder), "--data-dir", str(service.data_dir), **database)
        assert second.returncode == 0, second.stdout + second.stderr
        analysed = not database  # from results alone, which are compared on either database
        before = everything(client, analysed=analysed)
    held = gridpose_here("restore", str(folder), "--data-dir", str(service.data_dir), **database)
    assert held.returncode == 2
    assert service.stop() == 0
    emptied(database)

    restored = gridpose_here("restore", str(folder), "--data-dir", str(tmp_path / "restored"), **database)
    assert restored.returncode == 0, restored.stdout + restored.stderr
    again = make_service("restored", GRIDPOSE_WORKERS="0", **database).start()
    assert again.admin_key is None, "the keys are those of the backup"
    with ServiceClient(again.url, key) as client:
        assert everything(client, analysed=analysed) == before


def test_a_second_service_on_another_folder_is_refused(
    make_service: MakeService, postgres_url: str, tmp_path: Path
) -> None:
    service = make_service(GRIDPOSE_WORKERS="0", GRIDPOSE_DATABASE_URL=postgres_url).start()
    other = gridpose(
        "serve", "--port", "0", "--data-dir", str(tmp_path / "other"), GRIDPOSE_DATABASE_URL=postgres_url
    )
    assert other.returncode == 2
    assert "ins_" in other.stderr, "the installation that the database belongs to is named"
    assert not (tmp_path / "other" / "key-pepper").exists()
    with ServiceClient(service.url, service.admin_key) as client:
        client.get("/v1/sessions")


def test_the_schema_is_taken_back_and_comes_up_again(
    make_service: MakeService, database: dict[str, str]
) -> None:
    """And stays while the service runs."""
    service = make_service(GRIDPOSE_WORKERS="0", **database)
    folder = str(service.data_dir)
    made = gridpose_here(
        "keys", "create", "k", "--scope", "admin", "--init", "--data-dir", folder, **database
    )
    found = re.search(r"gp_\w+", made.stdout)
    assert found, made.stdout + made.stderr
    shown = gridpose_here("schema", "downgrade", "0004", "--data-dir", folder, **database)
    assert shown.returncode == 1
    assert (
        "0004" not in gridpose_here("schema", "show", "--data-dir", folder, **database).stdout.splitlines()[0]
    )
    unknown = gridpose_here("schema", "downgrade", "0099", "--yes", "--data-dir", folder, **database)
    assert unknown.returncode == 2
    done = gridpose_here("schema", "downgrade", "0004", "--yes", "--data-dir", folder, **database)
    assert done.returncode == 0, done.stderr
    assert "0004" in gridpose_here("schema", "show", "--data-dir", folder, **database).stdout.splitlines()[0]
    (copy,) = (service.data_dir / "backups").iterdir()
    connection = sqlite3.connect(copy)
    assert connection.execute("SELECT count(*) FROM api_keys").fetchone() == (1,)
    connection.close()
    later = gridpose_here("backup", str(service.data_dir.parent / "b"), "--data-dir", folder, **database)
    assert later.returncode == 2
    assert "0004" in later.stderr
    service.start()
    with ServiceClient(service.url, found[0]) as client:
        client.get("/v1/sessions")
        running = gridpose_here("schema", "downgrade", "0004", "--yes", "--data-dir", folder, **database)
        assert running.returncode == 1
        shown = gridpose_here("schema", "show", "--data-dir", folder, **database)
        assert "0004" not in shown.stdout.splitlines()[0]
