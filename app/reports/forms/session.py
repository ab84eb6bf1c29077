"""Sections of a report on a whole session: what was measured, and in short what each analysis found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from app.reports.forms.blocks import (
    UNKNOWN,
    Block,
    excluded_of,
    facts,
    heading,
    number,
    paragraph,
    table,
)
from app.reports.forms.camera import camera_blocks
from app.reports.forms.repeatability import headline
from app.reports.forms.wording import Json, words


def session_blocks(analyses: Mapping[str, Json], refusals: Mapping[str, Json], inputs: Json) -> list[Block]:
    """Return the sections; an analysis that was refused stands with its reason."""
    counted, listed = _measurements(inputs)
    blocks = counted
    if "repeatability" in analyses:
        found = analyses["repeatability"]
        blocks += [heading("Repeatability"), *headline(found)]
        blocks += excluded_of(found, inputs, "Excluded from repeatability") if found["excluded"] else []
    if "intrinsics" in analyses:
        blocks += camera_blocks(analyses["intrinsics"], inputs)
    for name, one in refusals.items():
        blocks += [
            heading(f"No {words(name)}"),
            paragraph(" ".join(part for part in (one["detail"], one["advice"]) if part)),
        ]
    return [*blocks, *listed]


def _measurements(inputs: Json) -> tuple[list[Block], list[Block]]:
    """Return how many measurements there are, and the list of all images, which comes last."""
    images, measured = inputs["images"], inputs["measured_poses"]
    found = Counter("succeeded" if one["failure_code"] is None else one["failure_code"] for one in images)
    rows = [(words(code), str(count)) for code, count in sorted(found.items())]
    listed = [
        [
            one["pose_id"],
            UNKNOWN if one["cycle"] is None else str(one["cycle"]),
            one["filename"] or one["sha256"][:16],
            words(one["failure_code"] or "succeeded"),
            number(one["rms_px"], places=4),
        ]
        for one in images
    ]
    blocks = [
        heading("Measurements"),
        facts([("images", str(len(images))), *rows, ("poses of another instrument", str(len(measured)))]),
    ]
    columns = ("pose", "cycle", "image", "outcome", "rms, px")
    caption = "Images; rms: of the image's own calibration, where it has one"
    found_list = table(caption, columns, listed, text_columns=4)
    return blocks, [heading("Images"), *found_list] if found_list else []
