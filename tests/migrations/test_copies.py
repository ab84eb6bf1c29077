"""A database is copied before it is changed, and the newest copies are kept."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.records import migrations
from app.records.database import Database
from tests.support.records.filled_tables import fill, revisions
from tests.support.service.backups import content


def test_the_newest_copies_are_kept(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'x.sqlite3'}")
    migrations.upgrade(database, tmp_path)
    (tmp_path / "backups").mkdir()
    (tmp_path / "backups" / "mine.sqlite3").touch()
    # By their time, whatever revision they are of.
    made = [migrations.back_up(database, tmp_path / "backups", revision) for revision in "98765"]
    database.dispose()
    left = {path.name for path in (tmp_path / "backups").iterdir()}
    assert left == {"mine.sqlite3", *(path.name for path in made[-migrations.KEPT_COPIES :])}


def test_an_existing_database_is_copied_before_it_is_changed(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    before = fill(database)
    migrations.downgrade(database, revisions()[-2])
    migrations.upgrade(database, tmp_path)
    (backup,) = (tmp_path / "backups").iterdir()
    assert backup.stat().st_mode & 0o077 == 0
    copied = Database(f"sqlite:///{backup}")
    assert migrations.current_revision(copied) == revisions()[-2]
    migrations.upgrade(copied, tmp_path, copy_first=False)
    assert content(copied) == before
    copied.dispose()


def test_a_copy_is_of_one_schema_and_content(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    before = fill(database)
    backup = migrations.back_up(database, tmp_path / "backups", "0001")
    copied = Database(f"sqlite:///{backup}")
    assert content(copied) == before
    copied.dispose()


def test_an_upgrade_backs_up_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A later revision, made here, is applied to a database with data in it."""
    package = tmp_path / "later" / "migrations"
    shutil.copytree(Path(migrations.migration_config().get_main_option("script_location") or ""), package)
    head = migrations.head_revision()
    (package / "versions" / "later.py").write_text(
        f"""
import sqlalchemy as sa
from alembic import op
revision, down_revision, branch_labels, depends_on = "later", "{head}", None, None
def upgrade():
    with op.batch_alter_table("sessions", recreate="always") as batch:
        batch.add_column(sa.Column("note", sa.Text(), nullable=True))
def downgrade():
    with op.batch_alter_table("sessions", recreate="always") as batch:
        batch.drop_column("note")
"""
    )
    database = Database(f"sqlite:///{tmp_path / 'x.sqlite3'}")
    migrations.upgrade(database, tmp_path)
    before = fill(database)
    original = migrations.migration_config

    def later_config(connection: sa.Connection | None = None) -> Any:
        config = original(connection)
        config.set_main_option("script_location", str(package))
        return config

    with monkeypatch.context() as patched:
        patched.setattr(migrations, "migration_config", later_config)
        migrations.upgrade(database, tmp_path)
        assert migrations.current_revision(database) == "later"
        # Recreating the parent table with foreign keys on would have deleted everything that refers to it.
        assert content(database) == before
        migrations.downgrade(database, head)
    assert content(database) == before
    (backup,) = (tmp_path / "backups").iterdir()
    copied = Database(f"sqlite:///{backup}")
    assert content(copied) == before
    assert migrations.current_revision(copied) == head
    copied.dispose()
    with database.engine.connect() as connection:
        assert connection.exec_driver_sql("PRAGMA foreign_keys").scalar() == 1
    database.dispose()
