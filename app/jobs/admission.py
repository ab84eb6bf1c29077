"""What is checked before it is acknowledged: an upload by magic bytes and header, never decoded; a target's markers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.errors import InvalidContent, ServiceError, UnsupportedContent
from core.errors import (
    EmptyImage,
    GridposeError,
    ImageTooManyPixels,
    InvalidTarget,
    UndecodableImage,
    UnsupportedImage,
)
from core.image import HEADER_BYTES, ImageHeader, check_pixels, read_header
from core.targets import TargetSpec, check_detectable
from core.targets.target_fields import check_fields

_REFUSALS: tuple[tuple[type[GridposeError], type[ServiceError]], ...] = (
    (EmptyImage, InvalidContent),
    (UnsupportedImage, UnsupportedContent),
    (ImageTooManyPixels, InvalidContent),
    (UndecodableImage, InvalidContent),
)


@dataclass(frozen=True, slots=True)
class AdmittedImage:
    """What the header says."""

    format: str
    width_px: int
    height_px: int


def admit_image(path: Path, max_pixels: int) -> AdmittedImage:
    """Return what the file's header says, or raise the refusal it deserves.

    The beginning of the file is enough for all but a TIFF that keeps its directory at the end.
    """
    try:
        header = _read_header(path)
        check_pixels(header, max_pixels)
    except GridposeError as error:
        for kind, refusal in _REFUSALS:
            if isinstance(error, kind):
                raise refusal(error.detail, error.advice, code=error.code) from error
        raise
    return AdmittedImage(header.format, header.width_px, header.height_px)


def admit_target(fields: dict[str, Any]) -> None:
    """Refuse a target that no image can ever be measured with, such as one with too few grid points or markers that do
    not fit, and one with fields that its kind has not: whoever sent them means another.

    `fields` are those of `core.TargetSpec`. Raises InvalidContent.
    """
    try:
        target = TargetSpec(**fields)
        check_fields(target)
        check_detectable(target)
    except InvalidTarget as error:
        wrong = [(error.field, error.detail)] if error.field is not None else []
        raise InvalidContent(error.detail, error.advice, code=error.code, errors=wrong) from error


def _read_header(path: Path) -> ImageHeader:
    with path.open("rb") as file:
        beginning = file.read(HEADER_BYTES)
        try:
            return read_header(beginning)
        except UndecodableImage:
            rest = file.read()
            if not rest:
                raise
    return read_header(beginning + rest)
