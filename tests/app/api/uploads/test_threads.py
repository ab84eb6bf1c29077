"""The threads that store images: answers, errors, who is acting, and work that is waited for."""

from __future__ import annotations

import asyncio
import threading
from contextvars import ContextVar

import pytest

from app.api.upload_threads import UploadThreads

_WHO: ContextVar[str] = ContextVar("who", default="nobody")


def _fail() -> None:
    raise ValueError("no image")


def test_answers_errors_and_the_callers_context_come_through() -> None:
    async def ask() -> tuple[str, str]:
        threads = UploadThreads()
        _WHO.set("key_1")
        with pytest.raises(ValueError, match="no image"):
            await threads.run(_fail)
        return await threads.run(_WHO.get), await threads.run(lambda: threading.current_thread().name)

    who, thread = asyncio.run(ask())
    assert who == "key_1"
    assert thread == "upload-0", "a second call needs no second thread"


def test_no_more_threads_than_allowed_work_at_a_time() -> None:
    most, working, seen, lock = 3, 0, [], threading.Lock()
    together = threading.Barrier(most)

    def work(number: int) -> int:
        nonlocal working
        with lock:
            working += 1
            seen.append(working)
        together.wait(120.0)  # all of them at once, or never
        with lock:
            working -= 1
        return number

    async def ask() -> list[int]:
        threads = UploadThreads(most)
        return list(await asyncio.gather(*(threads.run(lambda n=n: work(n)) for n in range(4 * most))))

    assert asyncio.run(ask()) == list(range(4 * most))
    assert max(seen) == most


def test_who_is_cancelled_waits_for_the_end_of_the_work() -> None:
    begun, may_end, ended = threading.Event(), threading.Event(), threading.Event()

    def work() -> None:
        begun.set()
        may_end.wait(120.0)
        ended.set()

    async def ask() -> None:
        task = asyncio.create_task(UploadThreads().run(work))
        await asyncio.to_thread(begun.wait, 120.0)
        for _ in range(2):
            task.cancel()
            await asyncio.sleep(0)
            await asyncio.sleep(0)
            assert not task.done(), "its file would be removed under the thread"
        may_end.set()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert ended.is_set()

    asyncio.run(ask())


def test_without_further_threads_those_that_are_there_do_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    async def ask() -> list[int]:
        threads = UploadThreads()

        def refuse(_thread: threading.Thread) -> None:
            raise RuntimeError("can't start new thread")

        with monkeypatch.context() as patch:
            patch.setattr(threading.Thread, "start", refuse)
            with pytest.raises(RuntimeError):
                await threads.run(lambda: 0)
        await threads.run(lambda: 0)
        monkeypatch.setattr(threading.Thread, "start", refuse)
        return list(await asyncio.gather(*(threads.run(lambda n=n: n) for n in range(5))))

    assert asyncio.run(ask()) == [0, 1, 2, 3, 4]
