"""Where analyses are asked for: what is known is answered at once, the rest is computed in a process of its own."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from app.errors import Conflict, NotFound, ServiceError, Unavailable
from app.jobs.side_process import Crowded, Lost, SideProcess, TimedOut
from app.services.analyses.outcome import Analysed, Refused
from app.services.analyses.revision import read_mark
from app.services.analyses.snapshot import read_snapshot
from app.services.installation import Installation

TIMEOUT_S = 180.0
WAITING_AT_MOST = 8
KEPT_BYTES = 64 * 1024 * 1024
KEPT_TAGS = 4096

Answer = TypeVar("Answer")
Question = tuple[str, str, tuple[tuple[str, str], ...]]
"""A session, an analysis and its settings."""


@dataclass(frozen=True, slots=True)
class Analysis:
    """A document and its entity tag; `body` is None where the client has it already."""

    etag: str
    body: bytes | None


class AnalysisDesk:
    """Answers analyses. The last documents are kept by what they were computed from, and the last tags by the marks
    that their sessions had.
    """

    def __init__(self, max_pixels: int) -> None:
        self._process = SideProcess(max_pixels, timeout_s=TIMEOUT_S, waiting_at_most=WAITING_AT_MOST)
        self._kept: OrderedDict[tuple[str, str], bytes] = OrderedDict()
        self._tags: OrderedDict[Question, tuple[str, str]] = OrderedDict()
        self._keeping = threading.Lock()

    def answer(
        self,
        installation: Installation,
        analysis: str,
        session_id: str,
        settings: Mapping[str, str],
        known_etags: frozenset[str],
    ) -> Analysis:
        """Return an analysis of the session as it is now.

        Raises NotFound, Conflict where it cannot be made, Unavailable where its process is crowded or died.
        """
        with installation.database.read() as records:
            mark = read_mark(records, session_id)
            question = (session_id, analysis, tuple(sorted(settings.items())))
            etag = self._tag(question, mark)
            if etag is None and known_etags:
                # The client asked before, this process did not: the hash is known sooner than the answer.
                snapshot = read_snapshot(records, session_id, settings.get("source", "images"))
                etag = entity_tag(snapshot.inputs_sha256(analysis, settings), snapshot.pending)
                self._keep_tag(question, mark, etag)
        if etag is not None and etag in known_etags:
            return Analysis(etag, None)
        body = self._find(session_id, etag) if etag is not None else None
        if etag is None or body is None:
            analysed = self._compute(installation, analysis, session_id, settings)
            etag, body = entity_tag(analysed.inputs_sha256, analysed.pending), analysed.body
            self._keep(session_id, etag, body)
            self._keep_tag(question, analysed.mark, etag)
        return Analysis(etag, None if known_etags & {etag, "*"} else body)

    def plan(
        self, robot: list[dict[str, float]], target: Mapping[str, Any], request: Mapping[str, Any]
    ) -> bytes:
        """Return what poses would tell of a robot; raises as `answer` does."""
        return self._call(compute_plan, robot, dict(target), dict(request))

    def begin_shutdown(self) -> None:
        """Let go of requests that wait for an analysis: they are told to ask again."""
        self._process.interrupt()

    def close(self) -> None:
        """End the process."""
        self._process.close()

    def _compute(
        self, installation: Installation, analysis: str, session_id: str, settings: Mapping[str, str]
    ) -> Analysed:
        url = installation.database.url.render_as_string(hide_password=False)
        return self._call(compute, url, analysis, session_id, dict(settings))

    def _call(self, function: Callable[..., Answer | Refused | ServiceFailure], *arguments: Any) -> Answer:
        try:
            outcome = self._process.call(function, *arguments)
        except Crowded:
            raise Unavailable(
                "Too many analyses are being computed.", "Ask again shortly.", code="busy"
            ) from None
        except TimedOut as error:
            raise Unavailable(
                f"The analysis took longer than {TIMEOUT_S:g} s and was stopped.",
                "Ask again when the server is less busy; if it happens again, divide the images among sessions.",
                code="analysis_interrupted",
            ) from error
        except Lost as error:
            raise Unavailable(
                "The process that computed the analysis ended unexpectedly.",
                "Ask again; if it happens again, the server may be short of memory: divide the images among sessions.",
                code="analysis_interrupted",
            ) from error
        if isinstance(outcome, Refused):
            raise Conflict(outcome.detail, outcome.advice, code=outcome.code)
        if isinstance(outcome, ServiceFailure):
            raise outcome.kind(outcome.detail, outcome.advice, code=outcome.code)
        return outcome

    def _tag(self, question: Question, mark: str) -> str | None:
        """Return the tag of an answer to the question, if one was given while the session had this mark."""
        with self._keeping:
            then, tag = self._tags.get(question, (None, None))
            return tag if then == mark else None

    def _keep_tag(self, question: Question, mark: str, etag: str) -> None:
        with self._keeping:
            self._tags[question] = mark, etag
            self._tags.move_to_end(question)
            while len(self._tags) > KEPT_TAGS:
                self._tags.popitem(last=False)

    def _find(self, session_id: str, etag: str) -> bytes | None:
        with self._keeping:
            body = self._kept.get((session_id, etag))
            if body is not None:
                self._kept.move_to_end((session_id, etag))
            return body

    def _keep(self, session_id: str, etag: str, body: bytes) -> None:
        with self._keeping:
            self._kept[session_id, etag] = body
            self._kept.move_to_end((session_id, etag))
            while sum(len(kept) for kept in self._kept.values()) > KEPT_BYTES:
                self._kept.popitem(last=False)


def entity_tag(inputs_sha256: str, pending: int) -> str:
    """Return the tag of a session's document: the same inputs and as many pending, the same bytes."""
    return f'"{hashlib.sha256(f"{inputs_sha256} {pending}".encode()).hexdigest()[:32]}"'


@dataclass(frozen=True, slots=True)
class ServiceFailure:
    """A refusal of the service's own, which travels between processes as plain values."""

    kind: type[NotFound] | type[Unavailable]
    code: str
    detail: str
    advice: str | None


def compute(
    url: str, analysis: str, session_id: str, settings: Mapping[str, str]
) -> Analysed | Refused | ServiceFailure:
    """Run in the process beside the head, which alone loads the numerics for it."""
    from app.services.analyses.computation import analyse, open_database

    try:
        return analyse(open_database(url), analysis, session_id, settings)
    except ServiceError as error:
        kind = NotFound if isinstance(error, NotFound) else Unavailable
        return ServiceFailure(kind, error.code, error.detail, error.advice)


def compute_plan(
    robot: list[dict[str, float]], target: Mapping[str, Any], request: Mapping[str, Any]
) -> bytes | Refused | ServiceFailure:
    """Run in the process beside the head."""
    from app.services.analyses.documents import encode
    from app.services.analyses.outcome import CannotAnalyse
    from app.services.analyses.planning import plan_document
    from core import GridposeError

    try:
        return encode(plan_document(robot, target, request))
    except CannotAnalyse as reason:
        return reason.refused
    except GridposeError as error:
        return Refused(error.code, error.detail, error.advice)
