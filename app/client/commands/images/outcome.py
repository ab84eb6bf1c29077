"""What became of an upload: counts, and refusals by reason."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ... import FilePlan, Json, describe_measured, is_measured
from .transfer import Transferred

_SHOWN = 8
_MIN_VISITS = 2
_FIGURES = re.compile(r"[0-9]+(\.[0-9]+)?|'[^']*'")
"""What differs between messages of one reason."""


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
    refused = []
    if measured is not None:
        names = {(o.file.pose_id, o.sha256): o.name for o in results}
        refused = [
            (
                names[m["pose_id"], m["sha256"]],
                f"{m['failure']['detail']} ({m['failure']['code']})",
                m["failure"]["advice"],
            )
            for m in measured.failed
            if not (cameras and is_measured(m))  # those serve: nothing is to be done about them
        ]
        console.print(describe_measured(measured.measurements, cameras))
        if refused:
            console.print(f"{len(refused)} refused")
        if measured.duplicates:
            console.print(f"{len(measured.duplicates)} already measured for every target: nothing to do")
        if line := _repeated_poses(measured.measurements):
            console.print(line)
    for title, rows in (("Not uploaded", failed), ("Refused", refused)):
        if rows:
            console.print(_list(title, rows))
    if transferred.session_id is not None:
        print(transferred.session_id)
    return 1 if failed or refused else 0


def _repeated_poses(measurements: Sequence[Json]) -> str:
    """Return for how many poses repeatability can be computed, whatever was refused."""
    visits = Counter(m["pose_id"] for m in measurements if is_measured(m))
    enough = sum(count >= _MIN_VISITS for count in visits.values())
    poses = len({m["pose_id"] for m in measurements})
    return (
        f"{enough} of {poses} poses have two measured images or more, as repeatability needs" if poses else ""
    )


def _list(title: str, rows: list[tuple[str, str, str | None]]) -> Table:
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
