"""A machine whose first start ends while it migrates the installation's database starts again."""

from __future__ import annotations

from pathlib import Path

import pytest
import sqlalchemy as sa

from app.errors import InstallationRefused
from app.records import migrations
from app.records.database import Database
from app.services.installation.context import ServiceContext
from app.settings import Settings
from tests.support.environment.postgres import EITHER_DATABASE

FORMER = "0007"
IN_THE_WAY = "reports"
"""A table of a later schema: where the name is taken, the migration to it ends in an error."""


@pytest.fixture(params=EITHER_DATABASE)
def former(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """The address of a database with the former schema, and with a table that stops its migration."""
    url = f"sqlite:///{tmp_path / 'x.sqlite3'}"
    if request.param == "postgresql":
        url = request.getfixturevalue("postgres_url")
    database = Database(url)
    migrations.upgrade(database, tmp_path, revision=FORMER)
    with database.engine.begin() as connection:
        connection.execute(sa.text(f"CREATE TABLE {IN_THE_WAY} (x INTEGER)"))
    database.dispose()
    return url


def test_a_first_start_that_ends_in_a_migration_is_repeated(former: str, tmp_path: Path) -> None:
    """It was refused: the copy in backups/ passed for somebody else's."""
    settings = Settings(data_dir=tmp_path / "data", database_url=former, workers=0)
    with pytest.raises(sa.exc.SQLAlchemyError):
        ServiceContext.open(settings)
    (copy,) = (settings.data_dir / "backups").iterdir()
    (copy.parent / f"{copy.name}.partial-wal").touch()  # and one that was killed while it copied
    database = Database(former)
    with database.engine.begin() as connection:
        connection.execute(sa.text(f"DROP TABLE {IN_THE_WAY}"))
    database.dispose()
    installation = ServiceContext.open(settings)
    assert migrations.current_revision(installation.database) == migrations.head_revision()
    installation.close()


def test_a_folder_with_other_backups_is_not_taken(former: str, tmp_path: Path) -> None:
    (tmp_path / "data" / "backups").mkdir(parents=True)
    (tmp_path / "data" / "backups" / "photographs.tar").touch()
    with pytest.raises(InstallationRefused) as caught:
        ServiceContext.open(Settings(data_dir=tmp_path / "data", database_url=former, workers=0))
    assert caught.value.code == "folder_foreign"
