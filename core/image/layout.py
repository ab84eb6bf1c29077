"""What the readers of the formats share: the header as a value, and reading numbers that may be missing."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from core.errors import UndecodableImage


@runtime_checkable
class ByteSource(Protocol):
    """A file's bytes: in memory, or on a disk from which only the slices asked for are read."""

    def __len__(self) -> int: ...

    def __getitem__(self, part: slice, /) -> bytes | memoryview: ...


@dataclass(frozen=True, slots=True)
class ImageHeader:
    """What a file's header states about its (first) image.

    `format` is png, jpeg, tiff or bmp; `bit_depth` the bits of one sample (of one index for a palette);
    `channels` the samples of one pixel as stored (1 for a palette).
    """

    format: str
    width_px: int
    height_px: int
    bit_depth: int
    channels: int

    @property
    def pixels(self) -> int:
        """Width times height."""
        return self.width_px * self.height_px


def unpack(layout: str, data: ByteSource, offset: int, what: str) -> tuple[int, ...]:
    """Return integers read at `offset` by a `struct` layout.

    Raises
    ------
    UndecodableImage
        The file ends before them.
    """
    end = offset + struct.calcsize(layout)
    if offset < 0 or end > len(data):
        raise UndecodableImage(f"The file ends inside {what}.")
    return struct.unpack(layout, data[offset:end])


def check_dimensions(width_px: int, height_px: int, format_name: str) -> None:
    """Raise UndecodableImage for an image without pixels."""
    if width_px <= 0 or height_px <= 0:
        raise UndecodableImage(f"The {format_name} header states {width_px} x {height_px} pixels.")
