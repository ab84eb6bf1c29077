"""What the database cannot do just now, as the service's own errors."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import sqlalchemy as sa

from app.errors import StorageFull, Unavailable
from app.logs import Logger, Sparingly
from app.records.database.engines import sqlite_driver

_SQLITE, _ = sqlite_driver()
_DAMAGE = ("database disk image is malformed", "file is not a database", "malformed database schema")
_NO_ROOM = ("disk is full", "disk i/o error", "no space left", "file too large")

log = Logger(__name__)
_may_repeat = Sparingly()


@dataclass(slots=True)
class Damage:
    """Whether a database was found damaged since it was opened: it does not mend itself."""

    seen: bool = False


def is_damage(error: BaseException) -> bool:
    """Return whether a driver's error, or SQLAlchemy's of it, says that the database's file is damaged."""
    return any(sign in str(getattr(error, "orig", error)).lower() for sign in _DAMAGE)


@contextmanager
def map_database_errors(damage: Damage) -> Iterator[None]:
    """Turn what the database cannot do just now into the service's own errors, and note that it is damaged.

    What the log says of the same reason, it says once a minute: a runner asks every second.
    """
    try:
        yield
    except (sa.exc.OperationalError, _SQLITE.OperationalError) as error:
        reason = str(getattr(error, "orig", error)).lower()
        if _may_repeat.due(reason):
            log.error("database_refused", reason=reason)
        if any(sign in reason for sign in _NO_ROOM):
            raise StorageFull() from error
        raise Unavailable(
            "The database cannot be reached or is busy.", "Try again shortly.", code="database_unavailable"
        ) from error
    except (sa.exc.DatabaseError, _SQLITE.DatabaseError) as error:
        if not is_damage(error):
            raise
        reason = str(getattr(error, "orig", error))
        damage.seen = True
        if _may_repeat.due(reason):
            log.critical("database_damaged", reason=reason)
        raise Unavailable(
            "The database is damaged.",
            "Stop the service and run `gridpose doctor` on the server: it says which backup to restore, and how.",
            code="database_damaged",
        ) from error
    except sa.exc.TimeoutError as error:
        raise Unavailable(
            "The database is busy.", "Try again shortly.", code="database_unavailable"
        ) from error
