"""Images of a folder, with the pose and cycle of each from its path.

Without a pattern:

    P1/0001.png           the pose is the file's folder; a name of digits only is the cycle
    P1/front-c7.png       the number after `c` or `cycle` at the end of the name is the cycle
    P1_0003.png, P1-c3.png: outside of any sub-folder the pose is the name without a cycle at its end
    P1/c3-b2.png          the number after `b` or `burst`, behind the cycle: which image of that stop it is

With one, `{pose}`, `{cycle}`, `{burst}` and `{any}` are matched against the path below the folder, with `/` between
folders on every system and without the file's suffix: `{any}/{pose}_cam0_{cycle}`.
"""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp"})
POSE_ID = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,127}")
MAX_CYCLE = 2**31 - 1
MAX_BURST = 1000

_BURST = r"(?:burst|b)[-_]?(?P<burst>[0-9]{1,4})"
_CYCLE_MARK = re.compile(
    rf"(?P<name>.*?)(?:^|[-_. ])(?:cycle|c)[-_]?(?P<cycle>[0-9]{{1,10}})(?:[-_. ]?{_BURST})?", re.IGNORECASE
)
_NUMBERED = re.compile(rf"(?P<name>.+)_(?P<cycle>[0-9]{{1,10}})(?:[-_. ]{_BURST})?", re.IGNORECASE)
_NUMBER = re.compile(rf"(?P<cycle>[0-9]{{1,10}})(?:[-_. ]{_BURST})?", re.IGNORECASE)
_PLACEHOLDER = re.compile(r"\{([^{}]*)\}")
_TRANSLITERATED = str.maketrans(
    {"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue", "ß": "ss"}
    | {"ø": "oe", "Ø": "Oe", "æ": "ae", "Æ": "Ae", "å": "aa", "Å": "Aa", "ł": "l", "Ł": "L"}
)
_FIELDS = {"pose": r"(?P<pose>[^/]+?)", "any": r"[^/]*?"}
_FIELDS |= {"cycle": r"(?P<cycle>[0-9]{1,10})", "burst": r"(?P<burst>[0-9]{1,4})"}
Tag = tuple[str, int | None, int | None]  # pose, cycle, and which image of that stop it is


class PatternError(ValueError):
    """The file-name pattern cannot be used; the message gives the reason."""


@dataclass(frozen=True, slots=True)
class ImageFile:
    """An image file, which of its stop's images it is (`burst`), its path below the folder (`name`), and the name that
    its pose has there if that is no pose ID (`label`)."""

    path: Path
    name: str
    pose_id: str
    cycle: int | None
    label: str | None = None
    burst: int | None = None


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


def plan_files(
    folder: Path, pattern: str | None = None, pose_id: str | None = None, *, first_cycle: int = 1
) -> FilePlan:
    """Search a folder and determine pose and cycle of every image.

    Parameters
    ----------
    folder
        Searched with its sub-folders, each once whatever links lead to it; hidden files and folders are ignored.
    pattern
        Placeholders in the path (see the module); None for the usual layouts.
    pose_id
        The pose of every file; the pattern, if any, then needs no `{pose}`.
    first_cycle
        Number of the first cycle in names, 0 or 1.

    Raises
    ------
    PatternError
        The pattern has an unknown placeholder, one of them twice, no `{pose}`, or `{burst}` without `{cycle}`.
    """
    matcher = None if pattern is None else compile_pattern(pattern, needs_pose=pose_id is None)
    images: list[ImageFile] = []
    skipped: list[Skipped] = []
    labels: dict[str, str] = {}
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
        given, cycle, burst = pose_id or tag[0], counted_from(tag[1], first_cycle), tag[2]
        pose, changed = legal_pose_id(given)
        if labels.setdefault(pose, given) != given:
            skipped.append(Skipped(name, f"{given!r} would be the same pose {pose} as {labels[pose]!r}"))
        elif not POSE_ID.fullmatch(pose):
            skipped.append(
                Skipped(name, f"{pose!r} is not a pose ID: 1-128 of letters, digits, '.', '_', '-'")
            )
        elif cycle is not None and not 1 <= cycle <= MAX_CYCLE:
            skipped.append(Skipped(name, impossible_cycle(cycle)))
        elif burst is not None and not 1 <= burst <= MAX_BURST:
            skipped.append(Skipped(name, f"burst index {burst} is not 1 to {MAX_BURST}"))
        else:
            images.append(ImageFile(path, name, pose, cycle, given if changed else None, burst))
    return FilePlan(tuple(images), tuple(skipped), others, tuple(repeated))


def number_cycles(
    images: Sequence[ImageFile], *, by_time: bool = False, after: Mapping[str, int] | None = None
) -> list[ImageFile]:
    """Return the images, those of poses none of which has a cycle numbered, in the order of their names or times.

    Parameters
    ----------
    images
        In natural order of their names.
    by_time
        Whether they are numbered by the time of their last change, and not by name.
    after
        Pose to the cycle after which it is numbered.
    """
    of_pose: dict[str, list[ImageFile]] = {}
    for image in images:
        of_pose.setdefault(image.pose_id, []).append(image)
    numbers: dict[ImageFile, int] = {}
    for pose_id, found in of_pose.items():
        if all(image.cycle is None for image in found):
            ordered = sorted(found, key=lambda image: image.path.stat().st_mtime_ns) if by_time else found
            first = (after or {}).get(pose_id, 0) + 1
            numbers |= {image: cycle for cycle, image in enumerate(ordered, first)}
    return [replace(image, cycle=numbers[image]) if image in numbers else image for image in images]


def compile_pattern(pattern: str, *, needs_pose: bool = True) -> re.Pattern[str]:
    """Turn a pattern with placeholders into a regular expression for a path without its suffix."""
    parts: list[str] = []
    position = 0
    seen: set[str] = set()
    for match in _PLACEHOLDER.finditer(pattern):
        field = match[1]
        if field not in _FIELDS:
            known = ", ".join(f"{{{name}}}" for name in _FIELDS)
            raise PatternError(f"{{{field}}} is not a placeholder; use one of {known}.")
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
    if "burst" in seen and "cycle" not in seen:
        raise PatternError(f"The pattern {pattern} has {{burst}} and no {{cycle}}, which names the stop.")
    return re.compile("".join(parts))


def tag_of(name: str, matcher: re.Pattern[str] | None = None) -> Tag | None:
    """Return pose, cycle and burst index of a file by its path; None where it does not match the pattern.

    Parameters
    ----------
    name
        The path, with `/` between folders.
    matcher
        As `compile_pattern` returns it; None for the usual layouts (see the module).
    """
    return _usual_tag(name) if matcher is None else _matched_tag(matcher, name)


def counted_from(cycle: int | None, first: int) -> int | None:
    """Return the cycle of a number in a name that counts from `first`."""
    return None if cycle is None else cycle - first + 1


def impossible_cycle(cycle: int) -> str:
    """Return why this is no cycle."""
    advice = "; give --first-cycle 0 where names count from 0" if cycle == 0 else ""
    return f"cycle {cycle} is not 1 to {MAX_CYCLE}{advice}"


def legal_pose_id(text: str) -> tuple[str, bool]:
    """Return a pose ID for a name people gave, and whether it differs from the name.

    Umlauts become two letters, other accents are dropped, and each run of other characters becomes a hyphen:
    `Größe 1` becomes `Groesse-1`. A name of which nothing is legal is returned as it is.
    """
    if POSE_ID.fullmatch(text):
        return text, False
    plain = unicodedata.normalize("NFKD", unicodedata.normalize("NFC", text).translate(_TRANSLITERATED))
    plain = "".join(c for c in plain if not unicodedata.combining(c))
    legal = re.sub(r"[^A-Za-z0-9._-]+", "-", plain).strip("-").lstrip(".")
    return (legal, True) if POSE_ID.fullmatch(legal) else (text, False)


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


def _matched_tag(matcher: re.Pattern[str], name: str) -> Tag | None:
    match = matcher.fullmatch(_without_suffix(name))
    return None if match is None else _tag(match.groupdict().get("pose") or "", match)


def _usual_tag(name: str) -> Tag:
    *folders, stem = _without_suffix(name).split("/")
    marked = _CYCLE_MARK.fullmatch(stem)
    if folders:
        return _tag(folders[-1], marked or _NUMBER.fullmatch(stem))
    split = marked or _NUMBERED.fullmatch(stem)
    return _tag(split["name"], split) if split and split["name"] else (stem, None, None)


def _tag(pose: str, match: re.Match[str] | None) -> Tag:
    """Return the pose with the numbers of a match, as far as it has them."""
    found = match.groupdict() if match is not None else {}
    cycle, burst = (None if found.get(name) is None else int(found[name]) for name in ("cycle", "burst"))
    return pose, cycle, burst
