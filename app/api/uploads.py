"""Receiving an image: to a file in the store, hashed on the way, never whole in memory."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request

from app.api.multipart import Form, boundary_of, read_form
from app.blobs.local import StagedBlob
from app.errors import InvalidContent, TooLarge, UnsupportedContent
from app.services.context import ServiceContext

_PIECE = 1024 * 1024  # bytes gathered before a thread is asked to write them
FORM_ROOM = 2 * 1024 * 1024  # what a form may have in addition to its file


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
async def receive_raw(request: Request, installation: ServiceContext) -> AsyncIterator[StagedBlob]:
    """Receive the whole body as a file; it is gone afterwards unless it was published."""
    limit = installation.settings.max_upload_bytes
    _check_length(request, limit, limit)
    async with _staged(request, installation) as receiver:
        async for chunk in request.stream():
            await receiver.write(chunk)
        await receiver.flush()
        yield receiver.staged


@asynccontextmanager
async def receive_form(
    request: Request, installation: ServiceContext
) -> AsyncIterator[tuple[StagedBlob, Form]]:
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
        await receiver.flush()
        if not form.has_file:
            raise InvalidContent(
                "The form holds no file.",
                "Send the image in the field `image`.",
                errors=[("image", "is required")],
            )
        yield receiver.staged, form


class _Receiver:
    """Gathers small chunks and writes them in a thread."""

    def __init__(self, staged: StagedBlob, limit: int) -> None:
        self.staged = staged
        self._limit = limit
        self._pending: list[bytes] = []
        self._pending_bytes = 0

    async def write(self, chunk: bytes) -> None:
        self._pending.append(chunk)
        self._pending_bytes += len(chunk)
        if self.staged.size + self._pending_bytes > self._limit:
            raise _too_large(self._limit)
        if self._pending_bytes >= _PIECE:
            await self.flush()

    async def flush(self) -> None:
        if self._pending:
            piece = b"".join(self._pending)
            self._pending, self._pending_bytes = [], 0
            await run_in_threadpool(self.staged.write, piece)


@asynccontextmanager
async def _staged(request: Request, installation: ServiceContext) -> AsyncIterator[_Receiver]:
    """Open a file to receive into, where there is room, and see to it that nothing is left of a failure."""
    stated = request.headers.get("content-length", "")
    wanted = int(stated) if stated.isdecimal() else 0
    installation.blobs.check_room(installation.settings.disk_floor_bytes, wanted)
    staged = installation.blobs.stage()
    try:
        yield _Receiver(staged, installation.settings.max_upload_bytes)
    except ClientDisconnect:
        raise InvalidContent(
            "The client went away before the image was complete.", code="incomplete_body"
        ) from None
    finally:
        staged.discard()


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
