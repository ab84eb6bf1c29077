"""The same for programs with an event loop: each call runs in a thread, so that the loop is never held up."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable, Coroutine
from types import TracebackType
from typing import Any, Concatenate, Generic, ParamSpec, Self, TypeVar

from .gridpose import Gridpose, Session

Sync = TypeVar("Sync")
Options = ParamSpec("Options")
Answer = TypeVar("Answer")


class _InThreads(Generic[Sync]):
    def __init__(self, sync: Sync) -> None:
        self._sync = sync


def _in_thread(
    call: Callable[Concatenate[Sync, Options], Answer],
) -> Callable[Concatenate[_InThreads[Sync], Options], Coroutine[Any, Any, Answer]]:
    """Return a method of `Gridpose` or `Session` as one that is awaited."""

    @functools.wraps(call)
    async def awaited(self: _InThreads[Sync], /, *args: Options.args, **options: Options.kwargs) -> Answer:
        return await asyncio.to_thread(call, self._sync, *args, **options)

    return awaited


class AsyncGridpose(_InThreads[Gridpose]):
    """A service, as `Gridpose` is one."""

    def __init__(self, url: str | None = None, key: str | None = None, *, retry_for_s: float = 300.0) -> None:
        super().__init__(Gridpose(url, key, retry_for_s=retry_for_s))

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await asyncio.to_thread(self._sync.close)

    async def sessions(self) -> list[AsyncSession]:
        """Return all sessions, oldest first."""
        return [AsyncSession(one) for one in await asyncio.to_thread(self._sync.sessions)]

    async def session(self, session: str, *, target: str | None = None) -> AsyncSession:
        """Return the session with this id or name; a new name makes one, given its `target`."""
        return AsyncSession(await asyncio.to_thread(self._sync.session, session, target=target))

    targets = _in_thread(Gridpose.targets)
    target = _in_thread(Gridpose.target)
    robots = _in_thread(Gridpose.robots)
    robot = _in_thread(Gridpose.robot)


class AsyncSession(_InThreads[Session]):
    """A session, as `Session` is one; `on_done` of `upload` is called from another thread."""

    @property
    def id(self) -> str:
        """The session's id."""
        return self._sync.id

    document = _in_thread(Session.document)
    upload = _in_thread(Session.upload)
    put_poses = _in_thread(Session.put_poses)
    wait = _in_thread(Session.wait)
    measurements = _in_thread(Session.measurements)
    repeatability = _in_thread(Session.repeatability)
    intrinsics = _in_thread(Session.intrinsics)
    camera_poses = _in_thread(Session.camera_poses)
    hand_eye = _in_thread(Session.hand_eye)
    dh = _in_thread(Session.dh)
    comparison = _in_thread(Session.comparison)
    save_overlay = _in_thread(Session.save_overlay)
    save_plot = _in_thread(Session.save_plot)
    delete = _in_thread(Session.delete)
