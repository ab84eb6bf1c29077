"""What an upload will do, said before it is done."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from ...images.files import FilePlan, ImageFile
from ..console import OptionRefused, number_of

FirstCycle = Annotated[
    int, typer.Option(help="Number of the first cycle in names: 0 where they count from 0.", min=0, max=1)
]
SESSION = typer.Option("--session", help="Id or name of the session; a new name creates one, given --target.")
TargetOption = Annotated[
    str | None,
    typer.Option(
        "--target",
        help="Target's id or name, sheet: and the id on its print (sheet:gp-5d49aa3e), or a new one by its form, e.g. "
        "chessboard:9x6:25 or charuco:9x6:25,marker=18,dictionary=DICT_5X5_100.",
    ),
]
_UNITS = ("B", "kB", "MB", "GB", "TB")
_THOUSAND = 1000.0
_SHOWN = 5


def show_intention(
    console: Console,
    images: Sequence[ImageFile],
    plan: FilePlan,
    session: str,
    target: str | None,
    numbered: int,
) -> None:
    """Print how many images of which poses go where, and what was derived of their names."""
    poses = Counter(image.pose_id for image in images)
    cycles = sorted(set(poses.values()))
    each = number_of(cycles[0], "cycle") if len(cycles) == 1 else f"{cycles[0]} to {cycles[-1]} cycles"
    total_bytes = sum(image.path.stat().st_size for image in images)
    what = (
        f"{number_of(len(poses), 'pose')} × {each} = {number_of(len(images), 'image')}, {_size(total_bytes)}"
    )
    seen = f", target {target}" if target is not None else ""
    console.print(escape(f"{what}; session {session}{seen}"))
    labels = {image.label: image.pose_id for image in images if image.label is not None}
    for label, pose_id in list(labels.items())[:_SHOWN]:
        console.print(escape(f"pose {label!r} becomes {pose_id}"))
    if len(labels) > _SHOWN:
        console.print(f"and {len(labels) - _SHOWN} more names of poses become pose IDs")
    if numbered:
        have = "has no cycle in its name and is" if numbered == 1 else "have no cycle in their names and are"
        console.print(f"{number_of(numbered, 'image')} {have} numbered for each pose (--cycles)")
    if plan.skipped:
        console.print(f"[yellow]{number_of(len(plan.skipped), 'image')} cannot be sent; listed at the end[/]")


def confirm(*, yes: bool) -> None:
    """Ask on a terminal whether to go on. Raises OptionRefused where the answer is no."""
    if yes or not (sys.stdin.isatty() and sys.stderr.isatty()):
        return
    if not typer.confirm("Send them?", default=True, err=True):
        raise OptionRefused(
            "Nothing was sent.", "Correct the options, or give --dry-run to see what they do."
        )


def _size(count: float) -> str:
    for unit in _UNITS:
        if count < _THOUSAND or unit == _UNITS[-1]:
            return f"{count:.3g} {unit}"
        count /= _THOUSAND
    return ""
