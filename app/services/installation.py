"""What one running service consists of: settings, database, originals, and the queue to wake."""

from __future__ import annotations

import os
import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from app.blobs.local import LocalBlobs
from app.jobs.embedded import EmbeddedRunner
from app.jobs.queue import Queue
from app.jobs.row_queue import RowQueue
from app.records import schema
from app.records.database import Database
from app.settings import Settings


@dataclass(frozen=True, slots=True)
class Installation:
    """The parts every use case draws on."""

    settings: Settings
    database: Database
    blobs: LocalBlobs
    queue: Queue
    pepper: bytes

    @classmethod
    def open(cls, settings: Settings) -> Self:
        """Open the data folder and the database, making and migrating them where needed."""
        settings.data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
        database = Database(settings.effective_database_url)
        schema.upgrade(database, settings.data_dir)
        return cls(
            settings=settings,
            database=database,
            blobs=LocalBlobs(settings.data_dir / "originals"),
            queue=RowQueue(database),
            pepper=load_pepper(settings),
        )

    def runner(self) -> EmbeddedRunner:
        """Return a runner for this installation's jobs, not yet started."""
        return EmbeddedRunner.for_data_dir(self.settings, self.database, self.queue, self.blobs)

    def close(self) -> None:
        """Close the database's connections."""
        self.database.dispose()


def load_pepper(settings: Settings) -> bytes:
    """Return the secret that API keys are hashed with; made on first use, readable by the owner only."""
    if settings.key_pepper is not None:
        return settings.key_pepper.get_secret_value().encode()
    path = settings.data_dir / "key-pepper"
    if not path.exists():
        _write_once(path, secrets.token_hex(32).encode())
    return path.read_bytes()


def _write_once(path: Path, content: bytes) -> None:
    """Write a file so that it appears whole, durable, and never replaces one another process just made."""
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(8)}")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    try:
        if hasattr(os, "link"):
            os.link(temporary, path)
        else:
            temporary.rename(path)
    except FileExistsError:
        pass
    finally:
        temporary.unlink(missing_ok=True)
