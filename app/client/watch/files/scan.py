"""Files of a watched folder, by polling: network shares report no changes."""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from ...images.files import SUFFIXES, natural_key

_SUFFIXES = tuple(SUFFIXES)


@dataclass(frozen=True, slots=True)
class Found:
    """An image file as it lies there. `place` is its path, `name` the path below the folder, with `/`."""

    place: str
    name: str
    signature: str

    @property
    def path(self) -> Path:
        """The place as a path, made where it is needed: a folder of many files is listed all the time."""
        return Path(self.place)


@dataclass(slots=True)
class Listing:
    """What one look at a folder found: images in no order, marker files, and what could not be read."""

    images: list[Found] = field(default_factory=list)
    markers: set[str] = field(default_factory=set)
    unreadable: dict[str, str] = field(default_factory=dict)


def signature_of(status: os.stat_result) -> str:
    """Return size, time of change and identity of a file: what differs when it is written to or replaced."""
    return f"{status.st_size}:{status.st_mtime_ns}:{status.st_ino}"


def list_folder(folder: Path, *, excluded: Path | None = None, marker: str | None = None) -> Listing:
    """List the images below a folder; hidden files, links to folders, pipes and devices are left unread.

    Parameters
    ----------
    folder
        The watched folder. Where it cannot be read at all, the listing is empty and `unreadable` has it as `.`.
    excluded
        A folder that is passed over, such as the one that files are moved to.
    marker
        Suffix of marker files, which are listed by the names they mark.
    """
    listing = Listing()
    folders = [(str(folder), "")]
    barred = None if excluded is None else excluded.resolve()
    while folders:
        place, prefix = folders.pop()
        try:
            with os.scandir(place) as entries:
                for entry in entries:
                    _sort_in(entry, prefix, barred, marker, listing, folders)
        except OSError as error:
            listing.unreadable[prefix.rstrip("/") or "."] = error.strerror or str(error)
    return listing


def in_natural_order(images: Iterable[Found]) -> list[Found]:
    """Return images in the order people give their names: `P2` before `P10`."""
    return sorted(images, key=lambda found: [natural_key(part) for part in found.name.split("/")])


def _sort_in(
    entry: os.DirEntry[str],
    prefix: str,
    barred: Path | None,
    marker: str | None,
    listing: Listing,
    folders: list[tuple[str, str]],
) -> None:
    name = prefix + entry.name
    if entry.name.startswith("."):
        return
    try:
        if entry.is_dir(follow_symlinks=False):
            if barred is None or Path(entry.path).resolve() != barred:
                folders.append((entry.path, f"{name}/"))
            return
        if marker is not None and entry.name.endswith(marker):
            listing.markers.add(name.removesuffix(marker))
            return
        if entry.name.lower().endswith(_SUFFIXES):
            name.encode("utf-8")
            # Not `entry.stat()`: on Windows it has no identity, and the size of a file being written is an old one.
            status = os.stat(entry.path)  # noqa: PTH116 - a path of each of 20,000 files takes longer than the look
            if stat.S_ISREG(status.st_mode):  # whoever opens a pipe waits for its writer
                listing.images.append(Found(entry.path, name, signature_of(status)))
    except FileNotFoundError:
        return  # it was moved or deleted meanwhile
    except UnicodeEncodeError:
        shown = name.encode("utf-8", "replace").decode("utf-8")
        listing.unreadable[shown] = "its name is not text; rename it"
    except OSError as error:
        listing.unreadable[name] = error.strerror or str(error)


class Settling:
    """Determines when files stand still: seen with the same signature for long enough, at two looks or more."""

    def __init__(self, settle_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._settle_s = settle_s
        self._clock = clock
        self._first_seen: dict[str, tuple[str, float]] = {}

    def still(self, images: Iterable[Found]) -> Iterator[Found]:
        """Yield those of the images that stand still; what is not among them any more is forgotten."""
        now = self._clock()
        seen: dict[str, tuple[str, float]] = {}
        for found in images:
            signature, since = self._first_seen.get(found.name, ("", now))
            if signature != found.signature:
                since = now
            seen[found.name] = (found.signature, since)
            if now - since >= self._settle_s:
                yield found
        self._first_seen = seen
