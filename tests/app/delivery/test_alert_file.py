"""The alert file: each notice in it once, whole, whatever happens to the file, its disk or the database."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.delivery import AlertFile
from app.records.tables import Notice
from app.services import notices
from tests.support.service.service import Api, wait_until


def put_notices(api: Api, count: int) -> None:
    with api.installation.database.write() as records:
        for _ in range(count):
            row = notices.note(records, "report.ready", {"report_id": "ø"})
            assert row is not None
            notices.take_up(records, row.id)


def numbers_in(path: Path) -> list[int]:
    return [json.loads(line)["number"] for line in path.read_text("utf-8").splitlines()]


def test_the_service_writes_the_alert_file(open_api: Any, tmp_path: Path) -> None:
    path = tmp_path / "share" / "alerts.jsonl"
    path.parent.mkdir()
    with open_api(alert_file=path) as api:
        place = api.installation.settings.data_dir / "alert-file.place"
        wait_until(place.exists, 120.0, "the file is begun")
        put_notices(api, 3)
        wait_until(lambda: path.exists() and len(numbers_in(path)) == 3, 120.0, "three lines are written")
    document = json.loads(path.read_text("utf-8").splitlines()[0])
    assert set(document) == {"number", "id", "type", "timestamp", "data"}


def test_a_line_is_there_once_and_whole_whatever_happened(api: Api, tmp_path: Path) -> None:
    api.service.delivery.stop()
    database, folder = api.installation.database, api.installation.settings.data_dir
    path, place = tmp_path / "alerts.jsonl", folder / "alert-file.place"
    put_notices(api, 2)
    file = AlertFile(database, path, folder)
    assert not file.append(), "what was before the file is not written"
    put_notices(api, 2)
    assert file.append()
    assert numbers_in(path) == [3, 4]
    # Killed after the lines and before their place; then a line that was halved by a power cut.
    place.write_text("2")
    with path.open("ab") as halved:
        halved.write(b'{"number":5,"id":"ntc_')
    put_notices(api, 2)
    file = AlertFile(database, path, folder)
    assert file.append()
    assert numbers_in(path) == [3, 4, 5, 6]
    path.unlink()  # taken away by its reader
    put_notices(api, 1)
    assert file.append()
    assert numbers_in(path) == [7]
    file = AlertFile(database, path, folder, max_bytes=path.stat().st_size + 1)
    put_notices(api, 1)
    assert file.append()
    assert (numbers_in(path), numbers_in(tmp_path / "alerts.jsonl.1")) == ([8], [7])


def test_a_full_disk_leaves_no_half_line_and_passes(
    api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    api.service.delivery.stop()
    path = tmp_path / "alerts.jsonl"
    file = AlertFile(api.installation.database, path, api.installation.settings.data_dir)
    file.append()
    put_notices(api, 1)
    assert file.append()
    whole = path.read_bytes()
    put_notices(api, 1)

    def full(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("app.delivery.alert_file.os.fsync", full)
        assert not file.append()
        assert not file.append()
        assert path.read_bytes() == whole
    assert file.append()
    assert numbers_in(path) == [1, 2]


def test_a_folder_that_is_not_there_stops_nothing(api: Api, tmp_path: Path) -> None:
    api.service.delivery.stop()
    path = tmp_path / "away" / "alerts.jsonl"
    file = AlertFile(api.installation.database, path, api.installation.settings.data_dir)
    file.append()
    put_notices(api, 1)
    assert not file.append()
    path.parent.mkdir()
    assert file.append()
    assert numbers_in(path) == [1]


@pytest.mark.parametrize("has_place", [True, False])
def test_an_older_database_put_back_loses_no_later_notice(api: Api, tmp_path: Path, has_place: bool) -> None:
    """A backup was restored: numbers go on from its last one, which the file has passed."""
    api.service.delivery.stop()
    database, folder = api.installation.database, api.installation.settings.data_dir
    path, place = tmp_path / "alerts.jsonl", folder / "alert-file.place"
    AlertFile(database, path, folder).append()
    put_notices(api, 4)
    assert AlertFile(database, path, folder).append()
    with database.write() as records:
        records.execute(sa.delete(Notice).where(Notice.number > 2))
    if not has_place:  # of the new data folder
        place.unlink()
    AlertFile(database, path, folder).append()
    put_notices(api, 1)
    assert AlertFile(database, path, folder).append()
    assert numbers_in(path) == [1, 2, 3, 4, 3]
