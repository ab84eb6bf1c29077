"""A service that keeps account of its processor time by stage. `python -m benchmarks.service.stages FILE COMMAND...`.

It runs `gridpose` with the functions of `STAGES` wrapped: each keeps the time that its own thread spends in it and in
nothing that is wrapped below it. What a thread spends outside of all is the rest of its row. SIGUSR1 writes the account
so far to FILE.
"""

from __future__ import annotations

import gc
import importlib
import inspect
import json
import re
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Generator
from pathlib import Path
from types import FrameType
from typing import Any

STAGES = {
    "request id, headers of the answer": "app.api.middleware.requests:RequestMiddleware.__call__",
    "log line": "app.api.middleware.requests:_Exchange._note",
    "metrics": "app.api.metrics:Metrics.request_done",
    "compression": "app.api.middleware.compression:Compression.__call__",
    "key": "app.api.middleware.authentication:ApiKeyAuth.__call__",
    "route": "app.api.direct:DirectRoutes.__call__",
    "receiving": "uvicorn.protocols.http.h11_impl:RequestResponseCycle.receive",
    "sending": "uvicorn.protocols.http.h11_impl:RequestResponseCycle.send",
    "scope of the key, activity": "app.api.direct:authorize",
    "session": "app.api.direct:find_parents",
    "path and query": "app.api.direct:_Parameters.read",
    "free space": "app.blobs.local:LocalBlobs.check_room",
    "to a thread and back": "app.api.uploads:Receiver.store",
    "answer": "app.api.routes.images:_stored",
    "rules before the transaction": "app.services.measurements:store_image",
    "write and hash": "app.blobs.local:StagedBlob.write",
    "fsync of the file": "app.blobs.local:StagedBlob.flush",
    "rename": "app.blobs.local:LocalBlobs.publish",
    "fsync of the folder": "app.blobs.local:sync_folder",
    "image header": "app.services.measurements.upload:validate_image",
    "BEGIN, COMMIT": "app.records.database.group_commit:GroupCommit.run",
    "rules in the transaction": "app.services.measurements.upload:accept",
    "audit entry": "app.records.database.database:append_entry_below_orm",
    "statements": "app.records.statements:DriverRows.all",
    "claims": "app.jobs.queue.sql_queue:SqlQueue.claim",
    "jobs of claimed rows": "app.jobs.queue.sql_queue:read_jobs",
    "results": "app.jobs.queue.sql_queue:SqlQueue.finish",
    "jobs to processes": "app.jobs.worker_pool:WorkerSlot.submit",
    "ends of jobs": "app.jobs.runner:JobRunner._on_end",
    "look after processes": "app.jobs.runner:JobRunner._tend",
    "settlement": "app.jobs.settlement:Settlement.settle",
    "rounds of the runner": "app.jobs.runner:JobRunner._work_once",
}
"""What is measured, and the function that does it, as module:name."""
_COLLECTOR = "garbage collection"
_NUMBER = re.compile(r"[-_ ]?\d+")


class Account:
    """Processor time by thread and stage; each thread writes to a page of its own."""

    def __init__(self) -> None:
        self._local = threading.local()
        self._pages: dict[tuple[str, int], _Page] = {}

    def page(self) -> _Page:
        """Return the present thread's page."""
        page: _Page | None = getattr(self._local, "page", None)
        if page is None:
            thread = threading.current_thread()
            page = self._local.page = _Page()
            self._pages[thread.name, thread.ident or 0] = page
        return page

    def document(self) -> dict[str, Any]:
        """Return the processor time so far: of the process, of its threads, and of their stages, s; and calls."""
        threads: Counter[str] = Counter()
        for thread in threading.enumerate():
            if thread.ident is not None:
                clock = time.pthread_getcpuclockid(thread.ident)
                threads[_kind(thread.name)] += time.clock_gettime_ns(clock)
        stages: dict[str, Counter[str]] = {}
        calls: Counter[str] = Counter()
        for (name, _), page in tuple(self._pages.items()):
            stages.setdefault(_kind(name), Counter()).update(dict(page.spent_ns))
            calls.update(dict(page.calls))
        return {
            "process_ns": time.process_time_ns(),
            "threads_ns": threads,
            "stages_ns": stages,
            "calls": calls,
        }


class _Page:
    """The stages that a thread is in, innermost last, and what it has spent in each."""

    def __init__(self) -> None:
        self.spent_ns: Counter[str] = Counter()
        self.calls: Counter[str] = Counter()
        self._within: list[str] = []
        self._since_ns = 0

    def enter(self, stage: str) -> None:
        now_ns = time.thread_time_ns()
        if self._within:
            self.spent_ns[self._within[-1]] += now_ns - self._since_ns
        self._within.append(stage)
        self._since_ns = now_ns

    def leave(self) -> None:
        now_ns = time.thread_time_ns()
        self.spent_ns[self._within.pop()] += now_ns - self._since_ns
        self._since_ns = now_ns


def _kind(thread: str) -> str:
    """Return a thread's name without its number."""
    return _NUMBER.sub("", thread)


def _wrapped(account: Account, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
    if inspect.iscoroutinefunction(function):

        async def stepped(*args: Any, **named: Any) -> Any:
            account.page().calls[stage] += 1
            return await _Steps(account, stage, function(*args, **named))

        return stepped

    def called(*args: Any, **named: Any) -> Any:
        page = account.page()
        page.calls[stage] += 1
        page.enter(stage)
        try:
            return function(*args, **named)
        finally:
            page.leave()

    return called


class _Steps:
    """A coroutine whose steps are accounted, and not what happens between them."""

    def __init__(self, account: Account, stage: str, work: Awaitable[Any]) -> None:
        self._account, self._stage, self._work = account, stage, work

    def __await__(self) -> Generator[Any, Any, Any]:
        steps = self._work.__await__()
        page, sent, raised = self._account.page(), None, None
        while True:
            page.enter(self._stage)
            try:
                awaited = steps.throw(raised) if raised is not None else steps.send(sent)
            except StopIteration as end:
                return end.value
            finally:
                page.leave()
            sent = raised = None
            try:
                sent = yield awaited
            except BaseException as error:  # noqa: BLE001 - it is the coroutine's
                raised = error


def install(account: Account) -> None:
    """Wrap every function of `STAGES`; a name that is gone is an error, and no silent zero."""
    for stage, place in STAGES.items():
        module, _, path = place.partition(":")
        owner: Any = importlib.import_module(module)
        *outer, name = path.split(".")
        for each in outer:
            owner = getattr(owner, each)
        setattr(owner, name, _wrapped(account, stage, getattr(owner, name)))

    def collecting(phase: str, _info: dict[str, int]) -> None:
        page = account.page()
        if phase == "start":
            page.calls[_COLLECTOR] += 1
            page.enter(_COLLECTOR)
        else:
            page.leave()

    gc.callbacks.append(collecting)


def main() -> None:
    file, command = Path(sys.argv[1]), sys.argv[2:]
    account = Account()
    install(account)

    def write(_number: int, _frame: FrameType | None) -> None:
        part = file.with_suffix(".part")
        part.write_text(json.dumps(account.document()), encoding="utf-8")
        part.replace(file)

    signal.signal(signal.SIGUSR1, write)
    # The command as `ServiceProcess` gives it: an interpreter, -m, the program and its arguments.
    sys.argv = command[2:]
    from app.cli.main import main as program

    program()


if __name__ == "__main__":
    main()
