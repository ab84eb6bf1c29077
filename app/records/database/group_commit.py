"""Transactions that come together are committed together: one fsync for all of them.

The first that comes begins at once. Those that come meanwhile wait, and one of them does the work of all: each in a
savepoint of its own, so that one that fails undoes nothing of the others', then one COMMIT. Nobody is answered before
that. Alone, a transaction waits for nobody and costs nothing more.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from contextvars import copy_context
from typing import Any, TypeVar

Answer = TypeVar("Answer")
MAX_TOGETHER = 64
"""Members of one transaction: beyond it, the first would wait too long for the last."""


class _Member:
    """One piece of work on its way into a transaction."""

    __slots__ = ("answer", "context", "error", "leads", "turn", "work")

    def __init__(self, work: Callable[[Any], Any]) -> None:
        self.work = work
        self.context = copy_context()  # who is acting: another thread may do the work
        self.answer: Any = None
        self.error: BaseException | None = None
        self.leads = False
        self.turn = threading.Lock()  # released when the member is done, or is to lead
        self.turn.acquire()


class GroupCommit:
    """Brings pieces of work into common transactions; safe to use from several threads.

    `transaction` begins one, yields the driver's cursor and what the work takes, and commits, or rolls back on an
    error.
    """

    def __init__(self, transaction: Callable[[], AbstractContextManager[tuple[Any, Any]]]) -> None:
        self._transaction = transaction
        self._lock = threading.Lock()
        self._waiting: list[_Member] = []
        self._busy = False

    def run(self, work: Callable[[Any], Answer]) -> Answer:
        """Return what `work` returns, once it is committed; raise what it or the commit raises."""
        member = _Member(work)
        with self._lock:
            self._waiting.append(member)
            member.leads = not self._busy
            self._busy = True
        if not member.leads:
            member.turn.acquire()
        if member.leads:
            self._lead()
        if member.error is not None:
            raise member.error
        answer: Answer = member.answer
        return answer

    def _lead(self) -> None:
        """Do the work of everybody who waits once the transaction has begun, then hand the lead on."""
        members: list[_Member] = []
        try:
            with self._transaction() as (cursor, argument):
                members = self._take()
                _work(members, cursor, argument)
        except BaseException as error:  # noqa: BLE001 - each member raises it
            members = members or self._take()
            for member in members:
                member.error = member.error or error
        finally:
            with self._lock:
                successor = self._waiting[0] if self._waiting else None
                self._busy = successor is not None
            for member in members:
                member.turn.release()
            if successor is not None:
                successor.leads = True
                successor.turn.release()

    def _take(self) -> list[_Member]:
        with self._lock:
            members, self._waiting = self._waiting[:MAX_TOGETHER], self._waiting[MAX_TOGETHER:]
        return members


def _work(members: list[_Member], cursor: Any, argument: Any) -> None:
    """Do the work of every member, those of several in a savepoint each."""
    if len(members) == 1:
        members[0].answer = members[0].context.run(members[0].work, argument)
        return
    for member in members:
        cursor.execute("SAVEPOINT member")
        try:
            member.answer = member.context.run(member.work, argument)
        except Exception as error:
            member.error = error
            if not cursor.connection.in_transaction:
                raise  # the database undid the whole transaction, as it does on a full disk
            cursor.execute("ROLLBACK TO member")
        cursor.execute("RELEASE member")
