"""Which files of a folder are images, and which pose and cycle each was taken at.

Without a pattern:

    P1/0001.png           the pose is the folder the file lies in; a name of digits only is the cycle
    P1/front-c7.png       ... as is a number after `c` or `cycle` at the name's end
    P1_0003.png           a file that lies in no sub-folder: the pose is the name, less a cycle at its end
    P1-c3.png

With one, `{pose}`, `{cycle}` and `{any}` are matched against the path below the folder, with `/` between
folders on every system and without the file's suffix: `{any}/{pose}_cam0_{cycle}`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
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
    """The file-name pattern cannot be used; the message says why."""


@dataclass(frozen=True, slots=True)
class ImageFile:
    """An image on this computer's disk and what its name says of it. `name` is the path below the folder."""

    path: Path
    name: str
    pose_id: str
    cycle: int | None


@dataclass(frozen=True, slots=True)
class Skipped:
    """An image that cannot be uploaded as it is named, and why."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class FilePlan:
    """What a folder holds: images with tags in natural order, images without, the number of other files."""

    images: tuple[ImageFile, ...]
    skipped: tuple[Skipped, ...]
    others: int


def plan_files(folder: Path, pattern: str | None = None, pose_id: str | None = None) -> FilePlan:
    """Walk a folder and tag every image in it.

    Parameters
    ----------
    folder
        Searched with its sub-folders; hidden files and folders are passed over.
    pattern
        Says where pose and cycle stand in the path (see the module); None for the usual layouts.
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
    for path in _files_below(folder):
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
            skipped.append(Skipped(name, f"{pose!r} is no pose ID: 1-128 of letters, digits, '.', '_', '-'"))
        elif cycle is not None and not 1 <= cycle <= MAX_CYCLE:
            skipped.append(Skipped(name, f"cycle {cycle} is not 1 or more"))
        else:
            images.append(ImageFile(path, name, pose, cycle))
    return FilePlan(tuple(images), tuple(skipped), others)


def compile_pattern(pattern: str, *, needs_pose: bool = True) -> re.Pattern[str]:
    """Turn a pattern with placeholders into a regular expression for a path without its suffix."""
    parts: list[str] = []
    position = 0
    seen: set[str] = set()
    for match in _PLACEHOLDER.finditer(pattern):
        field = match[1]
        if field not in _FIELDS:
            raise PatternError(f"{{{field}}} is no placeholder; use {{pose}}, {{cycle}} and {{any}}.")
        if field != "any" and field in seen:
            raise PatternError(f"{{{field}}} stands twice in the pattern {pattern}.")
        seen.add(field)
        parts += [re.escape(pattern[position : match.start()]), _FIELDS[field]]
        position = match.end()
    parts.append(re.escape(pattern[position:]))
    if needs_pose and "pose" not in seen:
        raise PatternError(
            f"The pattern {pattern} has no {{pose}}; add one, or name the pose of all files with --pose."
        )
    return re.compile("".join(parts))


def natural_key(text: str) -> list[tuple[int, int, str]]:
    """Return a sort key under which `P2` comes before `P10`."""
    return [
        (0, int(part), part) if part.isascii() and part.isdigit() else (1, 0, part.casefold())
        for part in re.split(r"([0-9]+)", text)
        if part
    ]


def _files_below(folder: Path) -> Iterator[Path]:
    visible = [entry for entry in folder.iterdir() if not entry.name.startswith(".")]
    for entry in sorted(visible, key=lambda e: natural_key(e.name)):
        if entry.is_dir():
            yield from _files_below(entry)
        elif entry.is_file():
            yield entry


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
