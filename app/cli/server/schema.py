"""`gridpose schema`: the schema of the database, and downgrades to an earlier one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import sqlalchemy as sa
import typer

from app.cli.context import data_failures, load_settings, print_location
from app.cli.options.data_folder import DataDir
from app.client.commands import fail
from app.errors import InstallationRefused
from app.records import migrations
from app.records.database import Database
from app.records.file_lock import AlreadyLocked, FileLock
from app.records.presence import RunnerLock
from app.records.tables import Installation
from app.services.installation.binding import require_installation, require_same, sqlite_path
from app.services.installation.identity import read_identity
from app.settings import Settings


def show(data_dir: DataDir = None) -> int:
    """Show the database's schema, this version's, and the earlier ones it can be downgraded to."""
    settings = load_settings(data_dir=data_dir)
    with _opened(settings) as database:
        current = migrations.current_revision(database)
    print(f"database      {current}")
    print(f"this version  {migrations.head_revision()}")
    for revision, subject in migrations.earlier_revisions(current):
        print(f"  earlier     {revision}  {subject}")
    return 0


def downgrade(
    revision: Annotated[str, typer.Argument(help="An earlier schema, as `schema show` lists them.")],
    data_dir: DataDir = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do it; without this, only show what is lost.")] = False,
) -> int:
    """Downgrade the database to an earlier schema, for an older version; a copy is made first."""
    settings = load_settings(data_dir=data_dir)
    with _opened(settings) as database, _exclusive(settings, database):
        current = migrations.current_revision(database)
        migrations.require_known(current)
        assert current is not None, "an installation's database has a schema"
        try:
            steps = migrations.what_is_lost(current, revision)
        except migrations.NotOnTheWayDown as error:
            fail(f"{error}.", "`gridpose schema show` lists the earlier ones.", code=2)
        print(f"From schema {current} to {revision} the following is lost:")
        for step, loss in steps:
            print(f"  {step}  {loss}")
        if not yes:
            print("Nothing was changed. Add --yes to downgrade.")
            return 1
        with FileLock(settings.data_dir / "migrate.lock"):
            copy = migrations.back_up(database, settings.data_dir / "backups", current)
            migrations.downgrade(database, revision)
    print(f"The schema is {revision}. Copy of the previous database: {copy}")
    print("Now install the version that uses this schema: this version upgrades it again when it starts.")
    return 0


@contextmanager
def _opened(settings: Settings) -> Iterator[Database]:
    """Open the database of an installation, whatever its schema."""
    print_location(settings)
    with data_failures(settings):
        require_installation(settings)
        file = sqlite_path(settings)
        if file is not None and not file.exists():
            raise InstallationRefused(
                "installation_not_in_database", f"The database {file} does not exist.", "Restore a backup."
            )
        database = Database(settings.effective_database_url)
        try:
            if sa.inspect(database.engine).has_table(Installation.__tablename__):
                with database.read() as records:
                    row = records.get(Installation, 1)
                if row is not None:
                    require_same(settings, read_identity(settings.data_dir), row)
            yield database
        finally:
            database.dispose()


@contextmanager
def _exclusive(settings: Settings, database: Database) -> Iterator[None]:
    """Lock out services and workers; a running one ends the command."""
    head, runner = (
        FileLock(settings.data_dir / "head.lock"),
        RunnerLock(settings.data_dir, database, alone=True),
    )
    try:
        head.acquire()
        runner.acquire()
    except AlreadyLocked:
        fail("A service or a worker uses this installation.", "Stop it, then repeat this command.")
    try:
        yield
    finally:
        runner.release()
        head.release()
