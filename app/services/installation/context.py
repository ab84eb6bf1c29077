"""The parts of a running service: settings, database, originals, and the queue to wake."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from app.blobs import Blobs, S3Blobs, open_store
from app.errors import InstallationRefused
from app.jobs.queue import Queue, queue_of
from app.records import ids, migrations
from app.records.database import Database
from app.records.file_lock import AlreadyLocked, FileLock
from app.records.presence import RunnerLock
from app.records.privacy import close_to_others
from app.records.tables import latest_ids
from app.services.installation import backends, binding
from app.services.installation.access import AccessCache
from app.settings import Settings

if TYPE_CHECKING:
    from app.jobs.runner import JobRunner


@dataclass(frozen=True, slots=True)
class ServiceContext:
    """The parts every use case draws on."""

    settings: Settings
    database: Database
    blobs: Blobs
    queue: Queue
    pepper: bytes
    access: AccessCache

    @classmethod
    def open(
        cls,
        settings: Settings,
        *,
        init: bool = True,
        adopt: bool = False,
        migrate: bool = True,
        holds_head_lock: bool = False,
        serves: bool = True,
    ) -> Self:
        """Open the data folder and the database, migrated where needed and where no other process uses them.

        With `init` a missing installation is made; `adopt` is `binding.bind`'s. The caller may hold the
        folder's `head.lock`. Without `serves` no pepper is needed. Raises InstallationRefused where database, folder,
        bucket and pepper do not belong together, where a schema in use would have to be changed, and without `migrate`
        where the schema is not this program's.
        """
        if init:
            binding.refuse_half_restored(settings)
            binding.refuse_foreign_folder(settings)
        else:
            binding.require_installation(settings)
        backends.refuse_moved(settings)
        settings.data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
        close_to_others(settings.data_dir)
        file = binding.sqlite_path(settings)
        if file is not None and not file.exists():  # connecting would make it
            binding.refuse_lost_database(settings, is_new=True, adopt=adopt)
        database = Database(settings.effective_database_url)
        try:
            current = migrations.current_revision(database)
            binding.refuse_lost_database(settings, is_new=current is None, adopt=adopt)
            is_first = init and current is None
            if current is None and not init and settings.is_shared:
                raise InstallationRefused(
                    "installation_missing",
                    "The database holds no installation.",
                    "Check GRIDPOSE_DATABASE_URL; `gridpose serve` makes a new installation.",
                )
            if migrate and not database.is_sqlite:
                _require_server(database)
            migrations.require_known(current)
            if not migrate and not is_first and current != migrations.head_revision():
                raise InstallationRefused(
                    "schema_not_current",
                    f"The database's schema is {current}; this version's is {migrations.head_revision()}.",
                    "Use the version that the service runs, or start `gridpose serve` of this one: it copies the "
                    "database to backups/ and brings it up to date.",
                )
            migrations.upgrade(
                database,
                settings.data_dir,
                alone=lambda: alone(settings, database, holds_head_lock=holds_head_lock),
            )
            pepper = binding.bind(settings, database, adopt=adopt, serves=serves)
            blobs = open_blobs(settings, database)
            if migrate and isinstance(blobs, S3Blobs):
                _require_bucket(settings, blobs, database, adopt=adopt)
            with database.read() as records:
                ids.follow(latest_ids(records))
        except BaseException:
            database.dispose()
            raise
        return cls(
            settings=settings,
            database=database,
            blobs=blobs,
            queue=queue_of(database),
            pepper=pepper,
            access=AccessCache(database),
        )

    def runner(self) -> JobRunner:
        """Return a runner for this installation's jobs, not yet started."""
        from app.jobs.runner import JobRunner  # loads the numerics, which most commands need not

        return JobRunner.for_data_dir(self.settings, self.database, self.queue, self.blobs)

    def close(self) -> None:
        """Close the database's connections."""
        self.database.dispose()


def open_blobs(settings: Settings, database: Database) -> Blobs:
    """Return the originals that settings name."""
    return open_store(settings.blob_url, settings.data_dir / "originals", database.exclude_others)


def _require_server(database: Database) -> None:
    backends.require_direct(database)
    backends.require_clock(database)


def _require_bucket(settings: Settings, blobs: S3Blobs, database: Database, *, adopt: bool) -> None:
    assert settings.blob_url is not None
    backends.require_bucket(blobs, settings.blob_url)
    backends.bind_bucket(blobs, settings.blob_url, database, adopt=adopt)


@contextmanager
def alone(settings: Settings, database: Database, *, holds_head_lock: bool = False) -> Iterator[None]:
    """Keep services and workers away. Raises InstallationRefused where one runs: it could not write a newer schema."""
    with ExitStack() as held:
        try:
            if not holds_head_lock:
                head = FileLock(settings.data_dir / "head.lock")
                head.acquire()
                held.callback(head.release)
            runner = RunnerLock(settings.data_dir, database, alone=True)
            runner.acquire()
            held.callback(runner.release)
        except AlreadyLocked as error:
            raise InstallationRefused(
                "service_running",
                f"A service or a worker of another version uses {settings.data_dir} or its database, whose schema this "
                "version would change.",
                "End every service and worker of this installation first; then start this version.",
            ) from error
        yield
