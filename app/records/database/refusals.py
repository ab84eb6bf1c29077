"""What the database cannot do just now, as the service's own errors."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import sqlalchemy as sa

from app.errors import StorageFull, Unavailable
from app.logs import Logger
from app.records.database.engines import sqlite_driver

_SQLITE, _ = sqlite_driver()
_DAMAGE = ("database disk image is malformed", "file is not a database")
_NO_ROOM = ("disk is full", "disk i/o error", "no space left", "file too large")

log = Logger(__name__)


@contextmanager
def refusals() -> Iterator[None]:
    """Turn what the database cannot do just now into the service's own errors."""
    try:
        yield
    except (sa.exc.OperationalError, _SQLITE.OperationalError) as error:
        reason = str(getattr(error, "orig", error)).lower()
        log.error("database_refused", reason=reason)
        if any(sign in reason for sign in _NO_ROOM):
            raise StorageFull() from error
        raise Unavailable(
            "The database cannot be reached or is busy.", "Try again shortly.", code="database_unavailable"
        ) from error
    except (sa.exc.DatabaseError, _SQLITE.DatabaseError) as error:
        reason = str(getattr(error, "orig", error))
        if not any(sign in reason.lower() for sign in _DAMAGE):
            raise
        log.critical("database_damaged", reason=reason)
        raise Unavailable(
            "The database is damaged.",
            "Stop the service, run `gridpose doctor` on the server, and restore a backup.",
            code="database_damaged",
        ) from error
    except sa.exc.TimeoutError as error:
        raise Unavailable(
            "The database is busy.", "Try again shortly.", code="database_unavailable"
        ) from error
