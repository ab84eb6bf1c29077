"""The file in which SQLite writes ahead."""

from __future__ import annotations

from pathlib import Path

import sqlalchemy as sa

from app.records.database import Database
from app.records.database.engines import MAX_IDLE_WAL_BYTES


def test_what_a_long_reader_made_of_the_write_ahead_log_is_given_back(tmp_path: Path) -> None:
    database = Database(sa.URL.create("sqlite", database=str(tmp_path / "rows.sqlite3")))
    log = tmp_path / "rows.sqlite3-wal"

    def write(megabytes: int) -> None:
        with database.write() as records:
            records.execute(sa.text(f"INSERT INTO filling VALUES (zeroblob({megabytes * 1024 * 1024}))"))

    with database.write() as records:
        records.execute(sa.text("CREATE TABLE filling (content BLOB)"))
    with database.snapshot() as reader:
        assert reader.execute(sa.text("SELECT count(*) FROM filling")).scalar_one() == 0
        for _ in range(3):
            write(10)
        assert log.stat().st_size > 30_000_000
    for _ in range(3):
        write(1)
    assert log.stat().st_size <= MAX_IDLE_WAL_BYTES
    database.dispose()
