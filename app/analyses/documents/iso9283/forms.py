"""The plan of a test by ISO 9283 as files: the document, its poses as a table, and a check list to print."""

from __future__ import annotations

import csv
import io
import json

from app.analyses.documents.iso9283.plan import POSE_FIELDS
from app.analyses.documents.iso9283.runs import Json


def _json(plan: Json) -> bytes:
    return json.dumps(plan, indent=2, allow_nan=False).encode() + b"\n"


def _csv(plan: Json) -> bytes:
    file = io.StringIO(newline="")
    table = csv.writer(file)
    table.writerow(["pose_id", "x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg", "approach"])
    for pose in (*plan["poses"], *plan["approach_poses"], *plan["additional_poses"]):
        angles = (pose[name] for name in POSE_FIELDS[2:])
        table.writerow([pose["pose_id"], *pose["position_mm"], *angles, pose.get("approach", "")])
    return file.getvalue().encode()


def _pdf(plan: Json) -> bytes:
    from app.reports.check_list import draw_check_list  # loads matplotlib

    return draw_check_list(plan)


PLAN_WRITERS = {".json": _json, ".csv": _csv, ".pdf": _pdf}
"""What writes a plan, by the suffix of the file."""
