"""Cache of analyses: documents and refusals by entity tag; tags and failures by the session's change token; the
token itself for as long as nobody writes to the database.
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from app.analyses.outcome import AnalysisRefused
from app.errors import ServiceError

CACHE_BYTES = 64 * 1024 * 1024
CACHE_TAGS = 4096
CACHE_FAILURES = 1024
FAILURE_KEPT_S = 600.0
"""For so long a question that took too much time or memory is answered as before, unless the session changes."""
_REFUSAL_BYTES = 1024  # about what one weighs

Question = tuple[str, str, tuple[tuple[str, str], ...]]
"""A session, an analysis and its settings."""


@dataclass(frozen=True, slots=True)
class _Failure:
    change_token: str
    until: float
    error: Callable[[int], ServiceError]


class AnswerCache:
    """The latest answers, within bounds of memory; safe from any thread."""

    def __init__(self) -> None:
        self._answers: OrderedDict[tuple[str, str], bytes | AnalysisRefused] = OrderedDict()
        self._bytes = 0
        self._tags: OrderedDict[Question, tuple[str, str]] = OrderedDict()
        self._failures: OrderedDict[Question, _Failure] = OrderedDict()
        self._change_tokens: dict[str, str] = {}
        self._data_version: tuple[int, int] | None = None
        self._lock = threading.Lock()

    def change_token(self, session_id: str, data_version: tuple[int, int] | None) -> str | None:
        """Return the session's change token, if it was read at this version of the database."""
        with self._lock:
            return self._change_tokens.get(session_id) if data_version == self._data_version else None

    def keep_change_token(
        self, session_id: str, data_version: tuple[int, int] | None, change_token: str
    ) -> None:
        """Note a change token that was read after this version of the database; None is no version."""
        with self._lock:
            is_full = len(self._change_tokens) >= CACHE_TAGS
            if data_version is None or data_version != self._data_version or is_full:
                self._change_tokens.clear()
                self._data_version = data_version
            if data_version is not None:
                self._change_tokens[session_id] = change_token

    def was_asked(self, question: Question) -> bool:
        """Return whether the question was answered lately, at whatever change token."""
        with self._lock:
            return question in self._tags

    def tag(self, question: Question, change_token: str) -> str | None:
        """Return the tag of the answer to the question, if it was given at this change token."""
        with self._lock:
            then, tag = self._tags.get(question, (None, None))
            return tag if then == change_token else None

    def keep_tag(self, question: Question, change_token: str, etag: str) -> None:
        """Note which answer the question has at this change token."""
        with self._lock:
            self._tags[question] = change_token, etag
            self._tags.move_to_end(question)
            while len(self._tags) > CACHE_TAGS:
                self._tags.popitem(last=False)

    def answer(self, session_id: str, etag: str) -> bytes | AnalysisRefused | None:
        """Return the document or the refusal of a tag; None if neither is kept."""
        with self._lock:
            answer = self._answers.get((session_id, etag))
            if answer is not None:
                self._answers.move_to_end((session_id, etag))
            return answer

    def keep(self, session_id: str, etag: str, answer: bytes | AnalysisRefused) -> None:
        """Keep a document or a refusal, and let go of the ones longest unused."""
        with self._lock:
            before = self._answers.pop((session_id, etag), None)
            self._answers[session_id, etag] = answer
            self._bytes += _size(answer) - (_size(before) if before is not None else 0)
            while self._bytes > CACHE_BYTES:
                self._bytes -= _size(self._answers.popitem(last=False)[1])

    def failure(self, question: Question, change_token: str) -> ServiceError | None:
        """Return why the question could not be answered lately, at this change token."""
        with self._lock:
            failure = self._failures.get(question)
            if failure is None:
                return None
            left = failure.until - time.monotonic()
            if failure.change_token != change_token or left <= 0.0:
                del self._failures[question]
                return None
            return failure.error(round(left) + 1)

    def keep_failure(
        self, question: Question, change_token: str, error: Callable[[int], ServiceError]
    ) -> None:
        """Note why the question cannot be answered now; `error` is given the seconds until it may be asked again."""
        with self._lock:
            self._failures[question] = _Failure(change_token, time.monotonic() + FAILURE_KEPT_S, error)
            self._failures.move_to_end(question)
            while len(self._failures) > CACHE_FAILURES:
                self._failures.popitem(last=False)


def _size(answer: bytes | AnalysisRefused) -> int:
    return len(answer) if isinstance(answer, bytes) else _REFUSAL_BYTES
