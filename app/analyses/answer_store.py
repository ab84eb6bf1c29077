"""Answers of analyses in the database, for the services that share it: what one has computed, the others give as well.

On PostgreSQL only; a service alone keeps its answers in memory. An answer is found by the session's change token, so
that it is out of date by itself. Nothing depends on it: what cannot be read or written is computed.
"""

from __future__ import annotations

import hashlib
import random
from dataclasses import asdict

import sqlalchemy as sa

from app.analyses.answer_cache import Question
from app.analyses.outcome import AnalysisRefused
from app.build import analyses_build
from app.logs import Logger
from app.records.database import Database

MAX_BYTES = 32 * 1024 * 1024
"""A larger answer is not kept."""
MAX_ALL_BYTES = 1024 * 1024 * 1024
KEPT_DAYS = 30
_TIDIED_EVERY = 50  # answers

log = Logger(__name__)

_FIND = sa.text(
    "SELECT etag, body, refusal FROM analysis_answers WHERE session_id = :session_id AND question = :question"
).columns(sa.column("etag", sa.String), sa.column("body", sa.LargeBinary), sa.column("refusal", sa.JSON))
_USE = sa.text(
    "UPDATE analysis_answers SET used_at = now() WHERE session_id = :session_id AND question = :question "
    "AND used_at < now() - interval '1 hour'"
)
_KEEP = sa.text(
    "INSERT INTO analysis_answers (session_id, question, etag, body, refusal, bytes) "
    "SELECT id, :question, :etag, :body, :refusal, :bytes FROM sessions WHERE id = :session_id "
    "ON CONFLICT DO NOTHING"
).bindparams(
    sa.bindparam("body", type_=sa.LargeBinary), sa.bindparam("refusal", type_=sa.JSON(none_as_null=True))
)
_TIDY = sa.text(
    "DELETE FROM analysis_answers WHERE used_at < now() - make_interval(days => :days) OR (session_id, question) IN ("
    "SELECT session_id, question FROM (SELECT session_id, question, "
    "sum(bytes) OVER (ORDER BY used_at DESC, session_id, question) AS newer FROM analysis_answers) AS kept "
    "WHERE newer > :most)"
)


def find_answer(
    database: Database, question: Question, change_token: str
) -> tuple[str, bytes | AnalysisRefused] | None:
    """Return the tag of an answer and the answer, None where no service has given it at this change token."""
    if database.is_sqlite:
        return None
    values = {"session_id": question[0], "question": _name(question, change_token)}
    try:
        with database.engine.begin() as connection:
            row = connection.execute(_FIND, values).one_or_none()
            if row is None:
                return None
            connection.execute(_USE, values)
    except sa.exc.SQLAlchemyError as error:
        log.warning("answer_not_found", error=type(error).__name__)
        return None
    return row.etag, AnalysisRefused(**row.refusal) if row.body is None else bytes(row.body)


def keep_answer(
    database: Database, question: Question, change_token: str, etag: str, answer: bytes | AnalysisRefused
) -> None:
    """Keep an answer for the other services; the ones longest unused make room."""
    size = len(answer) if isinstance(answer, bytes) else 1024
    if database.is_sqlite or size > MAX_BYTES:
        return
    is_document = isinstance(answer, bytes)
    values = {
        "session_id": question[0],
        "question": _name(question, change_token),
        "etag": etag,
        "body": answer if is_document else None,
        "refusal": None if isinstance(answer, bytes) else asdict(answer),
        "bytes": size,
    }
    try:
        with database.engine.begin() as connection:
            connection.execute(_KEEP, values)
            if random.randrange(_TIDIED_EVERY) == 0:  # noqa: S311 - a guess at how full it is
                connection.execute(_TIDY, {"days": KEPT_DAYS, "most": MAX_ALL_BYTES})
    except sa.exc.SQLAlchemyError as error:
        log.warning("answer_not_kept", error=type(error).__name__)


def _name(question: Question, change_token: str) -> str:
    """Return what a question at one state of its session is known by; another program gives another answer."""
    text = repr((question, change_token, analyses_build()))
    return hashlib.sha256(text.encode()).hexdigest()
