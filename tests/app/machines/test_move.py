"""An installation moved from one machine's files to PostgreSQL and S3: all of it, also when interrupted."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.cli.server.migrate_to import migrate_to
from app.errors import BackupRefused, InstallationRefused
from app.records.tables import Measurement
from app.services.backup import make_backup, move_installation, restore_backup
from app.services.installation.context import ServiceContext
from app.settings import Settings
from tests.support.environment.postgres import new_database
from tests.support.image.images import small_image
from tests.support.service.service import Api

pytestmark = [pytest.mark.postgres, pytest.mark.slow]


@pytest.fixture
def filled(open_api: Any, tmp_path: Path) -> tuple[Path, str, list[str]]:
    """The data folder of an installation with images of which one is computed, a session, and their measurements."""
    folder = tmp_path / "former"
    with open_api(folder) as api:
        assert isinstance(api, Api)
        session_id = api.make_session(name="tür ß")
        ids = [api.put_image(session_id, small_image(n), f"P{n}").json()["id"] for n in range(5)]
    return folder, session_id, ids


def test_everything_arrives_and_the_former_place_is_closed(
    filled: tuple[Path, str, list[str]],
    environment: dict[str, str],
    open_api: Any,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder, session_id, ids = filled
    url, bucket = environment["GRIDPOSE_DATABASE_URL"], environment["GRIDPOSE_BLOB_URL"]
    for name, value in environment.items():
        if name.startswith("AWS_"):
            monkeypatch.setenv(name, value)
    before = os.umask(0o077)

    # Interrupted after three images: what was read back is not copied again, and no row is there yet.
    source = ServiceContext.open(Settings(data_dir=folder, workers=0))

    def interrupt(done: int, _total: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        move_installation(source, url, bucket, interrupt)
    with pytest.raises(BackupRefused) as nothing:
        move_installation(source, None, None, lambda *_: None)
    assert nothing.value.code == "nothing_to_move"
    source.close()

    assert migrate_to(url, bucket, folder) == 0
    os.umask(before)
    printed = capsys.readouterr().out
    assert "5, each read back" in printed

    with pytest.raises(InstallationRefused) as moved:
        ServiceContext.open(Settings(data_dir=folder, workers=0))
    assert moved.value.code == "installation_moved"
    with open_api(folder, database_url=url, blob_url=bucket, workers=0) as api:
        assert api.client.get(f"/v1/sessions/{session_id}").json()["name"] == "tür ß"
        for number, measurement_id in enumerate(ids):
            assert api.client.get(f"/v1/measurements/{measurement_id}/image").content == small_image(number)
        with api.installation.database.read() as records:
            assert records.scalar(sa.select(sa.func.count()).select_from(Measurement)) == 5
            waiting = sa.text("SELECT count(*) FROM procrastinate_jobs WHERE status = 'todo'")
            assert records.scalar(waiting) == 5, "what was queued is queued"


def test_a_database_of_another_installation_is_refused(
    filled: tuple[Path, str, list[str]], environment: dict[str, str], tmp_path: Path
) -> None:
    url = environment["GRIDPOSE_DATABASE_URL"]
    ServiceContext.open(Settings(data_dir=tmp_path / "other", workers=0, database_url=url)).close()
    source = ServiceContext.open(Settings(data_dir=filled[0], workers=0))
    with pytest.raises(InstallationRefused) as caught:
        move_installation(source, url, None, lambda *_: None)
    assert caught.value.code == "installation_mismatch"
    source.close()
    ServiceContext.open(Settings(data_dir=filled[0], workers=0)).close()


def test_a_backup_of_a_bucket_comes_back_into_another_bucket(
    set_environment: dict[str, str],
    open_api: Any,
    store: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What docs/scale.md says: restore into a folder, then move that to a database and a bucket that are empty."""
    pepper = set_environment["GRIDPOSE_KEY_PEPPER"]
    places = {"database_url": set_environment["GRIDPOSE_DATABASE_URL"], "key_pepper": pepper, "workers": 0}
    with open_api(tmp_path / "head", blob_url=set_environment["GRIDPOSE_BLOB_URL"], **places) as api:
        session_id = api.make_session()
        ids = [api.put_image(session_id, small_image(n), f"P{n}").json()["id"] for n in range(3)]
        report = make_backup(api.installation, tmp_path / "backup")
        assert (report.copied, report.manifest.missing) == (3, [])
        key = api.client.headers["Authorization"]

    folder, bucket = tmp_path / "restored", f"s3://{store.new_bucket()}/again"
    for name in ("GRIDPOSE_DATABASE_URL", "GRIDPOSE_BLOB_URL"):
        monkeypatch.delenv(name)
    restore_backup(tmp_path / "backup", Settings(data_dir=folder, workers=0))
    with new_database() as url:
        assert migrate_to(url, bucket, folder) == 0
        with open_api(
            tmp_path / "new-head", database_url=url, blob_url=bucket, key_pepper=pepper, workers=0
        ) as api:
            for number, measurement_id in enumerate(ids):
                original = api.client.get(
                    f"/v1/measurements/{measurement_id}/image", headers={"Authorization": key}
                )
                assert original.content == small_image(number), "and the keys of that time are valid"
