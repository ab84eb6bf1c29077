"""What to watch, when a file is complete, and what becomes of it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchSettings:
    """How a folder is watched.

    Attributes
    ----------
    folder
        Searched with its sub-folders.
    session, target
        As `find_or_make_session` takes them.
    matcher
        Pose and cycle in the path, compiled; None for the usual layouts.
    pose_id
        The pose of all files.
    focus_group
        Tag of images taken at one focus setting.
    complete
        `settled`: a file is complete when it stands still for `settle_s` and is whole; `renamed`: as soon as it
        appears, since it is written elsewhere and renamed into place; `marker`: when a file of its name with the suffix
        `marker` lies next to it. In each case its structure must be whole.
    sidecar
        `auto`: a sidecar file or row is used where there is one; `required`: an image waits for it; `off`: neither.
    table
        The table of poses; None for `poses.csv` in the folder.
    first_cycle
        Number of the first cycle in names, 0 or 1; sidecars and tables count from 1.
    number_cycles
        Whether images without a cycle are numbered for each pose, in the order in which they are sent.
    after, moved_to
        What becomes of a file once it was measured: it is kept, moved to this folder, or deleted. A file that was sent
        and not measured is moved to `not-measured` there, and never deleted.
    live
        Whether each result is printed in one line.
    next_view
        What the next view is to make certain that is printed after each round of results; None for none.
    on_result
        A command that gets each result as JSON on its standard input; it is run without a shell.
    once
        Whether watching ends when nothing is left to do.
    give_up_s
        With `once`: how long the service may be away before watching ends.
    """

    folder: Path
    session: str
    target: str | None = None
    matcher: re.Pattern[str] | None = None
    pose_id: str | None = None
    focus_group: str | None = None
    complete: Literal["settled", "renamed", "marker"] = "settled"
    settle_s: float = 2.0
    marker: str = ".done"
    sidecar: Literal["auto", "required", "off"] = "auto"
    table: Path | None = None
    first_cycle: int = 1
    number_cycles: bool = False
    after: Literal["keep", "move", "delete"] = "keep"
    moved_to: Path | None = None
    live: bool = False
    next_view: str | None = None
    on_result: str | None = None
    parallel: int = 2
    poll_s: float = 1.0
    once: bool = False
    give_up_s: float = 300.0
    longest_pause_s: float = 60.0
    on_result_within_s: float = 60.0

    @property
    def needs_results(self) -> bool:
        """Whether results of images are read, which needs a key of scope read in addition to ingest."""
        return self.live or self.next_view is not None or self.on_result is not None or self.after != "keep"
