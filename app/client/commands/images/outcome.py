"""What became of an upload: counts, and refusals by reason."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ... import FilePlan, Json, describe_measured, is_measured
from ...summary import image_of
from ..console import number_of
from .transfer import Transferred

_SHOWN = 8
_MIN_VISITS = 2
_ADVICE = {
    "image_size_differs": "Images of another size are of another camera setting: upload them with a --focus-group of "
    "their own, or into a session of their own."
}
_LOOK = "Look at its overlay, and at the warnings of the session's intrinsics."
_FIGURES = re.compile(r"[0-9]+(\.[0-9]+)?|'[^']*'")
"""What differs between messages of one reason."""
_Row = tuple[str, str, str | None]
"""File, reason, advice."""


def report(console: Console, plan: FilePlan, transferred: Transferred) -> int:
    """Print what became of an upload, and return the exit code."""
    results, measured, cameras = transferred.results, transferred.measured, transferred.cameras
    sent = sum(o.status == "sent" for o in results)
    present = sum(o.status == "present" for o in results)
    failed = [(o.name, o.reason or "", o.advice) for o in results if o.status == "failed"]
    failed += [
        (s.name, s.reason, "Rename it, give --pattern or --pose, or make it readable.") for s in plan.skipped
    ]
    console.print(
        f"session {transferred.session_id}: {sent} sent, {present} already there, {len(failed)} failed"
    )
    for folder in plan.repeated:
        console.print(f"[yellow]not searched again: {escape(folder.name)}: {escape(folder.reason)}[/]")
    if plan.others:
        console.print(f"other files, not images by their names: {plan.others}")
    undetermined: list[_Row] = []
    refused: list[_Row] = []
    elsewhere: list[_Row] = []
    if measured is not None:
        names = {(o.file.pose_id, o.sha256): o.name for o in results}
        images = {image_of(m) for m in measured.measurements if is_measured(m)}
        for m in measured.failed:
            row = (
                names[image_of(m)],
                f"{m['failure']['detail']} ({m['failure']['code']})",
                m["failure"]["advice"],
            )
            if not is_measured(m) and image_of(m) not in images:
                refused.append(row)
            elif is_measured(m) and not cameras:  # with a camera they serve: nothing is to be done about them
                undetermined.append(row)
        reasons = {one["measurement_id"]: one for one in transferred.excluded}
        elsewhere += [
            (names[image_of(m)], f"{reason['detail']} ({reason['code']})", _ADVICE.get(reason["code"], _LOOK))
            for m in measured.measurements
            if is_measured(m) and m["excluded"] is None and (reason := reasons.get(m["id"]))
        ]
        console.print(describe_measured(measured.measurements, cameras))
        if refused:
            console.print(f"{number_of(len({name for name, *_ in refused}), 'photograph')} not measured")
        if measured.duplicates:
            console.print(f"{len(measured.duplicates)} already measured for every target: nothing to do")
        if line := _use(measured.measurements, cameras):
            console.print(line)
    for title, rows in (
        ("Not uploaded", failed),
        ("Not measured", refused),
        ("Measured, but the camera is not determined yet", undetermined),
        ("Measured, but not in the session's camera, and without a pose by it", elsewhere),
    ):
        if rows:
            console.print(_list(title, rows))
    if transferred.session_id is not None:
        print(transferred.session_id)
    return 1 if failed or refused or undetermined or elsewhere else 0


def _use(measurements: Sequence[Json], cameras: Sequence[Json] | None) -> str:
    """Return what the images are good for: repeatability where poses were visited again, else the camera."""
    sent = Counter(pose_id for pose_id, _ in {image_of(m) for m in measurements})
    if any(count >= _MIN_VISITS for count in sent.values()):
        measured = Counter(pose_id for pose_id, _ in {image_of(m) for m in measurements if is_measured(m)})
        enough = sum(count >= _MIN_VISITS for count in measured.values())
        have = "has" if enough == 1 else "have"
        return f"{enough} of {number_of(len(sent), 'pose')} {have} two measured images or more, as repeatability needs"
    if not cameras:
        return ""
    return (
        "next: `gridpose sessions export-camera`, or with commanded poses `gridpose hand-eye export`; repeatability "
        "needs each pose twice or more"
    )


def _list(title: str, rows: list[_Row]) -> Table:
    """Return the rows of a title, those of one reason together with their number."""
    table = Table(title=title, title_justify="left", show_lines=True)
    for column in ("images", "files", "reason", "what to do"):
        table.add_column(column, overflow="fold")
    groups: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for name, reason, advice in rows:
        groups.setdefault((_FIGURES.sub("#", reason), advice or ""), []).append((name, reason))
    for (_, advice), members in sorted(groups.items(), key=lambda group: -len(group[1])):
        names = ", ".join(name for name, _ in members[:_SHOWN])
        more = f" and {len(members) - _SHOWN} more" if len(members) > _SHOWN else ""
        table.add_row(str(len(members)), escape(names + more), escape(members[0][1]), escape(advice))
    return table
