"""Checks before an acknowledgement: an upload by magic bytes and header, without decoding; a target's markers."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from app.errors import InvalidContent, ServiceError, UnsupportedContent
from core.errors import (
    EmptyImage,
    GridposeError,
    ImageTooManyPixels,
    InvalidTarget,
    UndecodableImage,
    UnsupportedImage,
)
from core.image import ImageHeader, check_pixels, read_header
from core.targets import check_detectable, check_fields, target_of

_BLOCK_BYTES = 4096
"""Read at a time: segments of a JPEG stand up to 64 KiB apart, and what is between them is not looked at."""

_REFUSALS: tuple[tuple[type[GridposeError], type[ServiceError]], ...] = (
    (EmptyImage, InvalidContent),
    (UnsupportedImage, UnsupportedContent),
    (ImageTooManyPixels, InvalidContent),
    (UndecodableImage, InvalidContent),
)


@dataclass(frozen=True, slots=True)
class ImageInfo:
    """What the header says."""

    format: str
    width_px: int
    height_px: int


def validate_image(source: bytes | Path, max_pixels: int) -> ImageInfo:
    """Return what a file's header says, given its bytes or its path, or raise the refusal it deserves.

    Only the header is read, wherever it lies in the file, and its length is bounded: this runs in the process that
    answers all requests.
    """
    try:
        header = _read_header(source)
        check_pixels(header, max_pixels)
    except GridposeError as error:
        for kind, refusal in _REFUSALS:
            if isinstance(error, kind):
                raise refusal(error.detail, error.advice, code=error.code) from error
        raise
    return ImageInfo(header.format, header.width_px, header.height_px)


def validate_target(fields: dict[str, Any]) -> None:
    """Refuse a target that no image can ever be measured with, such as one with too few grid points or markers that do
    not fit, and one with fields that its kind has not: whoever sent them means another.

    `fields` are those of `core.targets.target_of`. Raises InvalidContent.
    """
    try:
        target = target_of(fields)
        check_fields(target)
        check_detectable(target)
    except InvalidTarget as error:
        wrong = [(error.field, error.detail)] if error.field is not None else []
        raise InvalidContent(error.detail, error.advice, code=error.code, errors=wrong) from error


def _read_header(source: bytes | Path) -> ImageHeader:
    if isinstance(source, bytes):
        return read_header(source)
    with source.open("rb", buffering=_BLOCK_BYTES) as file:
        return read_header(_FileBytes(file))


class _FileBytes:
    """The bytes of an open file, read when a slice of them is asked for."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._size = file.seek(0, os.SEEK_END)

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, part: slice) -> bytes:
        begin, end, _ = part.indices(self._size)
        self._file.seek(begin)
        return self._file.read(max(0, end - begin))
