"""Whose turn it is: sessions with queued images take turns, and within a session the oldest image comes first.

Both statements walk the index (status, session_id, id): the first from session to session, the second within each of
them, so that neither a session's ten thousand queued images nor hundreds of other sessions make a claim slower. They
are put together once: an idle machine spends more on building a statement than on answering it.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import zip_longest

import sqlalchemy as sa

from app.records.statements import Rows, Statement
from app.records.tables import Measurement

_AT_ONCE = 100
"""Sessions looked at by one statement; SQLite takes 500 terms of a compound one."""


def next_in_turn(rows: Rows, after: str, limit: int) -> list[tuple[str, str]]:
    """Return up to `limit` (session_id, measurement_id) of queued images, the session that follows `after` first."""
    sessions = [session_id for (session_id,) in rows.all(_waiting(following=True), after=after, limit=limit)]
    if len(sessions) < limit:
        rest = rows.all(_waiting(following=False), after=after, limit=limit - len(sessions))
        sessions += [session_id for (session_id,) in rest]
    if not sessions:
        return []
    queues: dict[str, list[str]] = {session_id: [] for session_id in sessions}
    for start in range(0, len(sessions), _AT_ONCE):
        some = sessions[start : start + _AT_ONCE]
        values: dict[str, str | int] = {f"session_{n}": session_id for n, session_id in enumerate(some)}
        values["of_each"] = -(-limit // len(sessions))
        for session_id, measurement_id in rows.all(_oldest(len(some)), **values):
            queues[session_id].append(measurement_id)
    rounds = zip_longest(*([(s, m) for m in sorted(queue)] for s, queue in queues.items()))
    return [turn for each in rounds for turn in each if turn is not None][:limit]


@lru_cache
def _waiting(*, following: bool) -> Statement:
    """Select up to `limit` sessions that have queued images, in the order of their ids: after `after`, or up to it."""
    session_id = Measurement.__table__.c.session_id
    after = sa.bindparam("after", type_=sa.String())
    least = sa.select(sa.func.min(session_id)).where(Measurement.__table__.c.status == "queued")
    if not following:
        least = least.where(session_id <= after)
    # One lower bound in each step, or SQLite walks from the wrong one.
    first = least.where(session_id > after) if following else least
    turn = sa.select(first.scalar_subquery().label("session_id"), sa.literal(1).label("place")).cte(
        "turn", recursive=True
    )
    next_one = least.where(session_id > turn.c.session_id).correlate(turn).scalar_subquery()
    turn = turn.union_all(
        sa.select(next_one, turn.c.place + 1).where(
            turn.c.session_id.is_not(None), turn.c.place < sa.bindparam("limit", type_=sa.Integer())
        )
    )
    return Statement(sa.select(turn.c.session_id).where(turn.c.session_id.is_not(None)))


@lru_cache
def _oldest(sessions: int) -> Statement:
    """Select the `of_each` oldest queued images of each of so many sessions."""
    table = Measurement.__table__.c
    queues = (
        sa.select(table.session_id, table.id)
        .where(table.status == "queued", table.session_id == sa.bindparam(f"session_{number}"))
        .order_by(table.id)
        .limit(sa.bindparam("of_each", type_=sa.Integer()))
        .subquery()
        for number in range(sessions)
    )
    return Statement(sa.union_all(*(sa.select(queue.c.session_id, queue.c.id) for queue in queues)))
