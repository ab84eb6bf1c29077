"""Receiving an image: to a file in the store, hashed on the way, never whole in memory unless it is small.

A small image is received first and then written, hashed, examined and stored by one thread. Of a larger one, a thread
writes and hashes each piece while the next one comes.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from typing import TypeVar

from starlette.requests import ClientDisconnect, Request

from app.api.multipart import Form, boundary_of, read_form
from app.api.problems import incomplete_body
from app.api.upload_threads import THREADS
from app.blobs.local import StagedBlob
from app.errors import InvalidContent, QuotaExceeded, TooLarge, UnsupportedContent
from app.http import key_of
from app.services.installation.context import ServiceContext
from app.services.measurements import check_quota, find_upload, has_image_of_size, read_use

Answer = TypeVar("Answer")
_PIECE = 512 * 1024
"""Bytes gathered before a thread is asked to write them; of two pieces, one is written while the other comes."""
FORM_ROOM = 2 * 1024 * 1024  # what a form may have in addition to its file


_FORM_FIELDS = 64 * 1024
"""More than the fields of a form and what stands between them take."""


def require_image_type(request: Request) -> None:
    """Raise UnsupportedContent unless the body is said to be raw bytes or an image; saying nothing means bytes."""
    media_type = (
        request.headers.get("content-type", "application/octet-stream").partition(";")[0].strip().lower()
    )
    if media_type != "application/octet-stream" and not media_type.startswith("image/"):
        raise UnsupportedContent(
            "The body must be the image itself.",
            "Send the file's bytes with Content-Type: application/octet-stream or image/*.",
        )


@asynccontextmanager
async def receive_raw(request: Request, installation: ServiceContext) -> AsyncIterator[Receiver]:
    """Receive the whole body; its file is gone afterwards unless it was published."""
    limit = installation.settings.max_upload_bytes
    _check_length(request, limit, limit)
    async with _staged(request, installation) as receiver:
        async for chunk in request.stream():
            await receiver.write(chunk)
        yield receiver


@asynccontextmanager
async def receive_form(
    request: Request, installation: ServiceContext
) -> AsyncIterator[tuple[Receiver, Form]]:
    """Receive a multipart form with the file in `image`."""
    boundary = boundary_of(request.headers.get("content-type", ""))
    if boundary is None:
        raise UnsupportedContent(
            "The body must be a multipart form.", "Send multipart/form-data with the file in `image`."
        )
    limit = installation.settings.max_upload_bytes
    _check_length(request, limit + FORM_ROOM, limit)
    async with _staged(request, installation) as receiver:
        form = await read_form(
            _at_most(request.stream(), limit + FORM_ROOM, limit),
            boundary,
            file_field="image",
            write=receiver.write,
        )
        if not form.has_file:
            raise InvalidContent(
                "The form holds no file.",
                "Send the image in the field `image`.",
                errors=[("image", "is required")],
            )
        yield receiver, form


class Receiver:
    """Gathers what comes of one image, and lets threads write it."""

    def __init__(self, staged: StagedBlob, limit: int) -> None:
        self._staged = staged
        self._limit = limit
        self._size = 0
        self._pending: list[bytes] = []
        self._pending_bytes = 0
        self._writing: asyncio.Task[None] | None = None

    async def write(self, chunk: bytes) -> None:
        """Take the next bytes. Raises TooLarge."""
        self._pending.append(chunk)
        self._pending_bytes += len(chunk)
        self._size += len(chunk)
        if self._size > self._limit:
            raise _too_large(self._limit)
        if self._pending_bytes >= _PIECE:
            await self._written()
            self._writing = asyncio.create_task(THREADS.run(partial(self._staged.write, self._gathered())))

    async def store(self, work: Callable[[StagedBlob], Answer]) -> Answer:
        """Let one thread write what is left and do `work` with the complete file; return what that returns."""
        await self._written()
        rest = self._gathered()

        def finish() -> Answer:
            if rest:
                self._staged.write(rest)
            return work(self._staged)

        return await THREADS.run(finish)

    async def discard(self) -> None:
        """Forget the image, unless it was published."""
        try:
            if self._writing is not None:
                await asyncio.wait((self._writing,))
                if not self._writing.cancelled():
                    self._writing.exception()  # which is of no more interest
        finally:
            self._staged.discard()

    def _gathered(self) -> bytes:
        piece = self._pending[0] if len(self._pending) == 1 else b"".join(self._pending)
        self._pending, self._pending_bytes = [], 0
        return piece

    async def _written(self) -> None:
        writing, self._writing = self._writing, None
        if writing is not None:
            await writing


@asynccontextmanager
async def _staged(request: Request, installation: ServiceContext) -> AsyncIterator[Receiver]:
    """Begin to receive where there is room, and see to it that nothing is left of a failure."""
    stated = request.headers.get("content-length", "")
    wanted = int(stated) if stated.isdecimal() else 0
    installation.blobs.check_room(installation.settings.disk_floor_bytes, wanted)
    receiver = Receiver(installation.blobs.stage(), installation.settings.max_upload_bytes)
    try:
        yield receiver
    except ClientDisconnect:
        raise incomplete_body("image") from None
    finally:
        await receiver.discard()


async def _at_most(chunks: AsyncIterator[bytes], limit: int, file_limit: int) -> AsyncIterator[bytes]:
    size = 0
    async for chunk in chunks:
        size += len(chunk)
        if size > limit:
            raise _too_large(file_limit)
        yield chunk


def _check_length(request: Request, limit: int, file_limit: int) -> None:
    stated = request.headers.get("content-length", "")
    if stated.isdecimal() and int(stated) > limit:
        raise _too_large(file_limit)


def _too_large(limit: int) -> TooLarge:
    return TooLarge(
        f"An image file may have at most {limit} bytes.",
        "Save the image compressed or smaller, or raise GRIDPOSE_MAX_UPLOAD_BYTES.",
        code="upload_too_large",
    )


def has_quota(request: Request) -> bool:
    """Return whether the request's key may send so much a day only."""
    key = key_of(request)
    return key is not None and key.bytes_per_day is not None


def require_quota(
    installation: ServiceContext, request: Request, image: tuple[str, str, str, str | None]
) -> None:
    """Refuse what is beyond the key's quota before it is received, unless it is here already and will not count."""
    stated = request.headers.get("content-length", "")
    try:
        _check_use(installation, request, int(stated) if stated.isdecimal() else 1)
    except QuotaExceeded:
        if find_upload(installation, *image) is None:
            raise


def require_form_quota(installation: ServiceContext, request: Request, session_id: str) -> None:
    """Refuse a form whose image is beyond the key's quota whatever else the form holds, before it is received.

    An image that is stored already does not count. The form, not yet received, says which image it is: a stored one of
    about this size may be it.
    """
    stated = request.headers.get("content-length", "")
    size = int(stated) if stated.isdecimal() else None
    try:
        _check_use(installation, request, max(1, (size or 0) - FORM_ROOM))
    except QuotaExceeded:
        if size is None:
            return
        with installation.database.read() as records:
            if not has_image_of_size(records, session_id, size - _FORM_FIELDS, size):
                raise


def _check_use(installation: ServiceContext, request: Request, size: int) -> None:
    """Raise QuotaExceeded where `size` bytes are beyond the quota of the request's key by what is stored of it."""
    key = key_of(request)
    assert key is not None, "has_quota"
    bytes_per_day, used = read_use(installation.database, key.id)
    check_quota(bytes_per_day, used, size)
