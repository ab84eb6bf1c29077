"""A pool that also lends its connections as the driver made them.

SQLAlchemy's own wrapper of a connection, made and ended for each transaction, costs a small one a tenth of its time.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from sqlalchemy.pool import ConnectionPoolEntry, QueuePool


class LendingPool(QueuePool):
    """Connections to SQLite; whoever borrows one waits for it like anybody else of the pool."""

    @contextmanager
    def lent(self) -> Iterator[tuple[Any, ConnectionPoolEntry]]:
        """Lend a connection of the driver, and its entry, which can be invalidated.

        One that comes back within a transaction is given up. Raises sqlalchemy.exc.TimeoutError where none is free for
        too long.
        """
        entry: Any = self._do_get()
        try:
            yield entry.get_connection(), entry
        finally:
            # None: the connection was invalidated, or none could be made.
            if entry.dbapi_connection is not None and entry.dbapi_connection.in_transaction:
                entry.invalidate()
            self._do_return_conn(entry)
