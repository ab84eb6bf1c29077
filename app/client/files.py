"""Images of a folder, with the pose and cycle of each from its path.

Without a pattern:

    P1/0001.png           the pose is the file's folder; a name of digits only is the cycle
    P1/front-c7.png       the number after `c` or `cycle` at the end of the name is the cycle
    P1_0003.png           a file outside of any sub-folder: the pose is the name without a cycle at its end
    P1-c3.png

With one, `{pose}`, `{cycle}` and `{any}` are matched against the path below the folder, with `/` between
folders on every system and without the file's suffix: `{any}/{pose}_cam0_{cycle}`.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp"})
POSE_ID = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,127}")
MAX_CYCLE = 2**31 - 1

_CYCLE_MARK = re.compile(r"(?P<name>.*?)(?:^|[-_. ])(?:cycle|c)[-_]?(?P<cycle>[0-9]{1,10})", re.IGNORECASE)
_NUMBERED = re.compile(r"(?P<name>.+)_(?P<cycle>[0-9]{1,10})")
_PLACEHOLDER = re.compile(r"\{([^{}]*)\}")
_FIELDS = {"pose": r"(?P<pose>[^/]+?)", "cycle": r"(?P<cycle>[0-9]{1,10})", "any": r"[^/]*?"}


class PatternError(ValueError):
    """The file-name pattern cannot be used; the message gives the reason."""


@dataclass(frozen=True, slots=True)
class ImageFile:
    """An image file with its pose and cycle. `name` is the path below the folder."""

    path: Path
    name: str
    pose_id: str
    cycle: int | None


@dataclass(frozen=True, slots=True)
class Skipped:
    """An image or folder that cannot be uploaded, and the reason."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class FilePlan:
    """Contents of a folder: images in natural order, images that cannot be uploaded, the number of other files, and
    folders that were already searched under another name."""

    images: tuple[ImageFile, ...]
    skipped: tuple[Skipped, ...]
    others: int
    repeated: tuple[Skipped, ...] = ()


def plan_files(folder: Path, pattern: str | None = None, pose_id: str | None = None) -> FilePlan:
    """Search a folder and determine pose and cycle of every image.

    Parameters
    ----------
    folder
        Searched with its sub-folders, each once whatever links lead to it; hidden files and folders are ignored.
    pattern
        Placeholders for pose and cycle in the path (see the module); None for the usual layouts.
    pose_id
        The pose of every file; the pattern, if any, then needs no `{pose}`.

    Raises
    ------
    PatternError
        The pattern has an unknown placeholder, one of them twice, or no `{pose}`.
    """
    matcher = None if pattern is None else compile_pattern(pattern, needs_pose=pose_id is None)
    images: list[ImageFile] = []
    skipped: list[Skipped] = []
    others = 0
    paths, repeated, unreadable = _files_below(folder)
    skipped += unreadable
    for path in paths:
        name = path.relative_to(folder).as_posix()
        if path.suffix.lower() not in SUFFIXES:
            others += 1
            continue
        tag = _usual_tag(name) if matcher is None else _matched_tag(matcher, name)
        if tag is None:
            skipped.append(Skipped(name, f"the name does not match the pattern {pattern}"))
            continue
        pose, cycle = pose_id or tag[0], tag[1]
        if not POSE_ID.fullmatch(pose):
            skipped.append(
                Skipped(name, f"{pose!r} is not a pose ID: 1-128 of letters, digits, '.', '_', '-'")
            )
        elif cycle is not None and not 1 <= cycle <= MAX_CYCLE:
            skipped.append(Skipped(name, f"cycle {cycle} is not 1 or more"))
        else:
            images.append(ImageFile(path, name, pose, cycle))
    return FilePlan(tuple(images), tuple(skipped), others, tuple(repeated))


def compile_pattern(pattern: str, *, needs_pose: bool = True) -> re.Pattern[str]:
    """Turn a pattern with placeholders into a regular expression for a path without its suffix."""
    parts: list[str] = []
    position = 0
    seen: set[str] = set()
    for match in _PLACEHOLDER.finditer(pattern):
        field = match[1]
        if field not in _FIELDS:
            raise PatternError(f"{{{field}}} is not a placeholder; use {{pose}}, {{cycle}} and {{any}}.")
        if field != "any" and field in seen:
            raise PatternError(f"{{{field}}} occurs twice in the pattern {pattern}.")
        seen.add(field)
        parts += [re.escape(pattern[position : match.start()]), _FIELDS[field]]
        position = match.end()
    parts.append(re.escape(pattern[position:]))
    if needs_pose and "pose" not in seen:
        raise PatternError(
            f"The pattern {pattern} has no {{pose}}; add it, or give the pose of all files with --pose."
        )
    return re.compile("".join(parts))


def natural_key(text: str) -> list[tuple[int, int, str]]:
    """Return a sort key under which `P2` comes before `P10`."""
    return [
        (0, int(part), part) if part.isascii() and part.isdigit() else (1, 0, part.casefold())
        for part in re.split(r"([0-9]+)", text)
        if part
    ]


def _files_below(folder: Path) -> tuple[list[Path], list[Skipped], list[Skipped]]:
    """Return the visible files in natural order, folders already searched under another name, and unreadable folders.

    Each folder is searched once, under its own name before any link's: a link to a folder above it would never end. A
    file is listed under each of its names.
    """
    files: list[Path] = []
    repeated: list[Skipped] = []
    unreadable: list[Skipped] = []
    seen: dict[tuple[int, int] | str, Path] = {}
    folders, links = [folder], list[Path]()
    while folders or links:
        here = folders.pop() if folders else links.pop(0)
        name = here.relative_to(folder).as_posix()
        try:
            first = seen.setdefault(_identity(here), here)
            if first != here:
                place = "the folder itself" if first == folder else first.relative_to(folder).as_posix()
                repeated.append(Skipped(name, f"it is another name of {place}, which was searched already"))
                continue
            entries = [entry for entry in here.iterdir() if not entry.name.startswith(".")]
        except OSError as error:
            unreadable.append(Skipped(name, f"the folder cannot be read: {error.strerror}"))
            continue
        for entry in sorted(entries, key=lambda entry: natural_key(entry.name)):
            if entry.is_dir():
                (links if _is_link(entry) else folders).append(entry)
            elif entry.is_file():
                files.append(entry)
    files.sort(key=lambda path: [natural_key(part) for part in path.relative_to(folder).parts])
    return files, repeated, unreadable


def _identity(folder: Path) -> tuple[int, int] | str:
    """Return an identifier shared by all names of a folder: device and inode, or the real path without an inode."""
    status = folder.stat()
    return (status.st_dev, status.st_ino) if status.st_ino else os.path.realpath(folder)


def _is_link(folder: Path) -> bool:
    """Return whether a folder is a link; a Windows junction is one whose real path differs."""
    if os.name != "nt":
        return folder.is_symlink()
    return os.path.realpath(folder) != str(Path(os.path.realpath(folder.parent), folder.name))


def _without_suffix(name: str) -> str:
    return name[: name.rindex(".")]


def _matched_tag(matcher: re.Pattern[str], name: str) -> tuple[str, int | None] | None:
    match = matcher.fullmatch(_without_suffix(name))
    if match is None:
        return None
    groups = match.groupdict()
    cycle = groups.get("cycle")
    return groups.get("pose") or "", None if cycle is None else int(cycle)


def _usual_tag(name: str) -> tuple[str, int | None]:
    *folders, stem = _without_suffix(name).split("/")
    marked = _CYCLE_MARK.fullmatch(stem)
    if folders:
        if marked:
            return folders[-1], int(marked["cycle"])
        digits = stem.isascii() and stem.isdigit() and len(stem) <= 10
        return folders[-1], int(stem) if digits else None
    split = marked or _NUMBERED.fullmatch(stem)
    if split and split["name"]:
        return split["name"], int(split["cycle"])
    return stem, None
