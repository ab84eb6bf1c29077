"""The same for programs with an event loop: each call runs in a thread, so that the loop is never held up."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from .gridpose import Gridpose, Session
from .http import Json
from .images.upload import UploadResult
from .results import Analysis, Measurement


class AsyncGridpose:
    """A service, as `Gridpose` is one."""

    def __init__(self, url: str | None = None, key: str | None = None, *, retry_for_s: float = 300.0) -> None:
        self._sync = Gridpose(url, key, retry_for_s=retry_for_s)

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

    async def targets(self) -> list[Json]:
        """Return all targets, oldest first."""
        return await asyncio.to_thread(self._sync.targets)

    async def target(self, target: str) -> str:
        """Return the id of the target with this id, name or form, made where it is new."""
        return await asyncio.to_thread(self._sync.target, target)

    async def robots(self) -> list[Json]:
        """Return all robots, oldest first."""
        return await asyncio.to_thread(self._sync.robots)

    async def robot(self, robot: str) -> Json:
        """Return the robot with this id or name."""
        return await asyncio.to_thread(self._sync.robot, robot)


class AsyncSession:
    """A session, as `Session` is one."""

    def __init__(self, session: Session) -> None:
        self._sync = session

    @property
    def id(self) -> str:
        """The session's id."""
        return self._sync.id

    async def document(self) -> Json:
        """Return the session as the service answers it."""
        return await asyncio.to_thread(self._sync.document)

    async def upload(
        self,
        folder: str | Path,
        *,
        pattern: str | None = None,
        pose_id: str | None = None,
        parallel: int = 2,
        on_done: Callable[[UploadResult], None] = lambda result: None,
    ) -> list[UploadResult]:
        """Send a folder's images; `on_done` is called from another thread."""
        return await asyncio.to_thread(
            self._sync.upload, folder, pattern=pattern, pose_id=pose_id, parallel=parallel, on_done=on_done
        )

    async def put_poses(
        self, poses: Sequence[Mapping[str, Any]], *, accept_implausible: bool = False
    ) -> None:
        """Store commanded poses, all or none."""
        await asyncio.to_thread(self._sync.put_poses, poses, accept_implausible=accept_implausible)

    async def wait(self, *, timeout_s: float = 3600.0) -> list[Measurement]:
        """Wait until no image is queued or running, and return all measurements."""
        return await asyncio.to_thread(self._sync.wait, timeout_s=timeout_s)

    async def measurements(self) -> list[Measurement]:
        """Return all measurements, oldest first."""
        return await asyncio.to_thread(self._sync.measurements)

    async def repeatability(self, **options: Any) -> Analysis:
        """Return the repeatability of ISO 9283."""
        return await asyncio.to_thread(self._sync.repeatability, **options)

    async def intrinsics(self, **options: Any) -> Analysis:
        """Return the camera of all images together."""
        return await asyncio.to_thread(self._sync.intrinsics, **options)

    async def camera_poses(self, **options: Any) -> Analysis:
        """Return the camera's pose in every image."""
        return await asyncio.to_thread(self._sync.camera_poses, **options)

    async def hand_eye(self, **options: Any) -> Analysis:
        """Return the camera on the flange and the target in the base."""
        return await asyncio.to_thread(self._sync.hand_eye, **options)

    async def dh(self, **options: Any) -> Analysis:
        """Return the robot's Denavit-Hartenberg parameters."""
        return await asyncio.to_thread(self._sync.dh, **options)

    async def comparison(self, **options: Any) -> Analysis:
        """Return the published methods next to this one."""
        return await asyncio.to_thread(self._sync.comparison, **options)

    async def save_overlay(self, measurement_id: str, path: str | Path) -> Path:
        """Write an image with the points found in it as PNG."""
        return await asyncio.to_thread(self._sync.save_overlay, measurement_id, path)

    async def save_plot(self, name: str, path: str | Path) -> Path:
        """Write a plot of the session as SVG."""
        return await asyncio.to_thread(self._sync.save_plot, name, path)

    async def delete(self) -> None:
        """Delete the session with everything in it."""
        await asyncio.to_thread(self._sync.delete)
