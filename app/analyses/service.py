"""Service of analyses: an answer comes from the cache, or is computed in a process of its own.

Equal requests for the same state of a session share one computation, which stops when the last client disconnects.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from starlette.concurrency import run_in_threadpool

from app.analyses.answer_cache import FAILURE_KEPT_S, AnswerCache, Question
from app.analyses.answer_store import find_answer, keep_answer
from app.analyses.computations import ServiceFailure, compute, compute_plan, compute_sheet
from app.analyses.inputs.change_token import read_change_token
from app.analyses.inputs.snapshot_reader import read_snapshot
from app.analyses.outcome import AnalysisRefused, AnalysisResult
from app.build import analyses_build
from app.errors import Conflict, ServiceError, Unavailable
from app.jobs.call_queue import Call, CallQueue, QueueFull, ShareTaken
from app.jobs.subprocess_executor import Limits, OutOfMemory, ProcessDied, TimedOut
from app.records.database import Database
from app.settings import Settings

PROCESSES = 2
"""At once; of them no key has more than one."""
PLACES = 16
"""Analyses that wait or are computed; of them no key has more than half."""

Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True)
class Analysis:
    """A document and its entity tag; `body` is None where the client has it already."""

    etag: str
    body: bytes | None


@dataclass(slots=True)
class _Asked:
    """A computation under way, and how many clients wait for it."""

    call: Call[Any]
    clients: int = 0


class AnalysisService:
    """Answers analyses of an installation's sessions, for one event loop."""

    def __init__(self, settings: Settings, database: Database) -> None:
        self._database = database
        self._limits = Limits(settings.analysis_timeout_s, settings.analysis_memory_bytes)
        self._calls = CallQueue(
            settings.max_image_pixels, processes=PROCESSES, places=PLACES, limits=self._limits
        )
        self._kept = AnswerCache()
        self._under_way: dict[Hashable, _Asked] = {}

    async def answer(
        self,
        analysis: str,
        session_id: str,
        settings: Mapping[str, str],
        known_etags: frozenset[str],
        requester: str | None = None,
    ) -> Analysis:
        """Return an analysis of the session as it is now; `requester` is the id of the key that asks.

        Raises NotFound, Conflict where it cannot be made, Unavailable where too many wait or its process died.
        Cancelled, it stops the computation unless others wait for it.
        """
        question = (session_id, analysis, tuple(sorted(settings.items())))
        change_token, etag = await run_in_threadpool(self._read, question, bool(known_etags))
        if etag is not None and etag in known_etags:
            return Analysis(etag, None)
        failure = self._kept.failure(question, change_token)
        if failure is not None:
            raise failure
        found = self._kept.answer(session_id, etag) if etag is not None else None
        if etag is None or found is None:
            shared = await run_in_threadpool(find_answer, self._database, question, change_token)
            if shared is not None:
                etag, found = shared
            else:
                analysed = await self._compute(question, change_token, requester)
                etag, found, change_token = (
                    entity_tag(analysed.answer_sha256),
                    analysed.outcome,
                    analysed.change_token,
                )
                await run_in_threadpool(keep_answer, self._database, question, change_token, etag, found)
            self._kept.keep(session_id, etag, found)
            self._kept.keep_tag(question, change_token, etag)
        if isinstance(found, AnalysisRefused):
            raise _conflict(found)
        return Analysis(etag, None if known_etags & {etag, "*"} else found)

    def kept(
        self, analysis: str, session_id: str, settings: Mapping[str, str]
    ) -> bytes | AnalysisRefused | None:
        """Return an analysis of the session as it is now where it is in the cache, from any thread; compute nothing."""
        question = (session_id, analysis, tuple(sorted(settings.items())))
        if not self._kept.was_asked(question):
            return None
        _, etag = self._read(question, False)
        return self._kept.answer(session_id, etag) if etag is not None else None

    async def sheet(
        self, target: Mapping[str, Any], options: Mapping[str, Any], requester: str | None = None
    ) -> bytes:
        """Return a target's sheet, on the first of `options["papers"]` that it fits; raises as `plan` does.

        `options` has also the `form` (`pdf`, `svg`) and the `name` that the sheet bears.
        """
        return await self.worked_out(
            ("sheet", repr((dict(target), dict(options)))),
            requester,
            compute_sheet,
            dict(target),
            dict(options),
        )

    async def plan(
        self,
        robot: Mapping[str, Any],
        target: Mapping[str, Any],
        request: Mapping[str, Any],
        requester: str | None = None,
    ) -> bytes:
        """Return what poses would make observable of a robot, given by its `joints` and `joint_coupling`.

        Raises as `answer` does.
        """
        asked = dict(robot), dict(target), dict(request)
        return await self.worked_out(("plan", repr(asked)), requester, compute_plan, *asked)

    async def worked_out(
        self, question: Hashable, requester: str | None, function: Callable[..., Any], *arguments: Any
    ) -> bytes:
        """Return what a function of no session returns; its refusal is Conflict. Raises as `answer` does, too."""
        outcome: bytes | AnalysisRefused = await self.run(question, requester, function, *arguments)
        if isinstance(outcome, AnalysisRefused):
            raise _conflict(outcome)
        return outcome

    async def run(
        self,
        question: Hashable,
        requester: str | None,
        function: Callable[..., Answer | ServiceFailure],
        *arguments: Any,
    ) -> Answer:
        """Return what `function` returns in a process of the analyses; equal questions share one call.

        Raises as `answer` does.
        """
        try:
            return await self._call(question, requester, function, *arguments)
        except (OutOfMemory, TimedOut) as error:
            raise self._failure(error)(5) from error

    @property
    def calls(self) -> CallQueue:
        """The bounded processes, for work that no request waits for."""
        return self._calls

    def counts(self) -> tuple[int, int]:
        """Return how many computations wait and how many run."""
        return self._calls.counts()

    def begin_shutdown(self) -> None:
        """Interrupt requests that wait for an analysis: each is answered with 503 and may be repeated."""
        self._calls.interrupt()

    def close(self) -> None:
        """End the processes."""
        self._calls.close()

    def _read(self, question: Question, has_tags: bool) -> tuple[str, str | None]:
        """Return the session's change token, and the answer's tag if it is known or the client has one to compare."""
        session_id, analysis, settings = question
        data_version = (
            self._database.data_version()
        )  # before the token: what is committed in between counts as later
        known = self._kept.change_token(session_id, data_version)
        if known is not None and (etag := self._kept.tag(question, known)) is not None:
            return known, etag
        with self._database.read() as records:
            change_token = read_change_token(records, session_id)
            self._kept.keep_change_token(session_id, data_version, change_token)
            etag = self._kept.tag(question, change_token)
            if etag is None and has_tags:
                # The client asked before, this process did not: the hash is known sooner than the answer.
                snapshot = read_snapshot(records, session_id, dict(settings).get("source", "images"))
                inputs_sha256 = snapshot.inputs_sha256(analysis, dict(settings))
                etag = entity_tag(snapshot.answer_sha256(inputs_sha256))
                self._kept.keep_tag(question, change_token, etag)
        return change_token, etag

    async def _compute(self, question: Question, change_token: str, requester: str | None) -> AnalysisResult:
        session_id, analysis, settings = question
        url = self._database.url.render_as_string(hide_password=False)
        try:
            return await self._call(
                (question, change_token), requester, compute, url, analysis, session_id, dict(settings)
            )
        except (OutOfMemory, TimedOut) as error:
            # The same inputs would take as much again.
            failure = self._failure(error)
            self._kept.keep_failure(question, change_token, failure)
            raise failure(round(FAILURE_KEPT_S)) from error

    async def _call(
        self,
        question: Hashable,
        requester: str | None,
        function: Callable[..., Answer | ServiceFailure],
        *arguments: Any,
    ) -> Answer:
        """Return what the function returns, computed once for all who ask the same meanwhile."""
        asked = self._under_way.get(question)
        if asked is None or asked.call.cancelled.is_set():
            try:
                asked = _Asked(self._calls.submit(requester, function, *arguments))
            except ShareTaken:
                raise Unavailable(
                    "This key has as many analyses under way as one key may.",
                    "Wait for their answers, then ask again.",
                    code="busy",
                ) from None
            except QueueFull:
                raise Unavailable(
                    "Too many analyses are being computed.", "Ask again shortly.", code="busy"
                ) from None
            except ProcessDied:
                raise _interrupted() from None
            self._under_way[question] = asked
        asked.clients += 1
        try:
            outcome = await asyncio.wrap_future(asked.call.future)
        except (OutOfMemory, TimedOut):
            raise
        except ProcessDied as error:
            raise _interrupted() from error
        finally:
            asked.clients -= 1
            if asked.clients == 0:
                if self._under_way.get(question) is asked:
                    del self._under_way[question]
                self._calls.cancel(asked.call)
        if isinstance(outcome, ServiceFailure):
            raise outcome.kind(outcome.detail, outcome.advice, code=outcome.code)
        answer: Answer = outcome
        return answer

    def _failure(self, error: ProcessDied) -> Callable[[int], ServiceError]:
        """Return what makes the refusal of a computation that took too much, given the seconds until it may be asked
        again.
        """
        if isinstance(error, OutOfMemory):
            return lambda _: Conflict(
                f"The analysis takes more memory than the {self._limits.memory_bytes} bytes it may have.",
                "Divide the images among sessions, or raise GRIDPOSE_ANALYSIS_MEMORY_BYTES.",
                code="analysis_too_large",
            )
        return lambda retry_after_s: Unavailable(
            f"The analysis took longer than {self._limits.time_s:g} s and was stopped.",
            "Divide the images among sessions, raise GRIDPOSE_ANALYSIS_TIMEOUT_S, or ask again when the server is "
            "less busy.",
            code="analysis_interrupted",
            retry_after_s=retry_after_s,
        )


def _interrupted() -> Unavailable:
    return Unavailable(
        "The process that computed the analysis ended unexpectedly.",
        "Ask again; if it happens again, the server may be short of memory: divide the images among sessions.",
        code="analysis_interrupted",
    )


def _conflict(refused: AnalysisRefused) -> Conflict:
    return Conflict(refused.detail, refused.advice, code=refused.code)


def entity_tag(answer_sha256: str) -> str:
    """Return the tag of a session's document: the same contents and program, the same bytes."""
    text = f"{answer_sha256} {analyses_build()}"
    return f'"{hashlib.sha256(text.encode()).hexdigest()[:32]}"'
