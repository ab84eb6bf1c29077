"""Reports as they are filed, made up of what histories and comparisons read of them, and stored without a session."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from typing import Any

from app.analyses.history import Summary, read_report
from app.records.tables import Report, ReportForm
from tests.support.service.service import Api

ROBOT = f"rob_{0:026d}"
FIRST = datetime(2020, 1, 1, tzinfo=UTC)
CONDITIONS = {"load_kg": 5.0, "speed_percent": 100.0, "temperature_c": 20.0}


def day(number: int) -> str:
    """The time of the session with this number: one each day."""
    return (FIRST + timedelta(days=number)).isoformat().replace("+00:00", "Z")


def content(number: int = 1, *, rp_mm: float = 0.05, poses: int = 3, **changes: Any) -> bytes:
    """The JSON form of a repeatability report, of what is read of it."""
    conditions = {**CONDITIONS, **changes.get("conditions", {})}
    commanded = [
        {
            "pose_id": f"P{k}",
            "position_mm": [100.0 * k, 0.0, changes.get("height_mm", 0.0)],
            **dict.fromkeys(("roll_deg", "pitch_deg"), 0.0),
            "yaw_deg": changes.get("turn_deg", 0.0) * k,
            "joint_angles_deg": None,
        }
        for k in range(1, poses + 1)
    ]
    found = [
        {
            "pose_id": one["pose_id"],
            "repeatability": {"rp_l_mm": rp_mm},
            "interval": {"rp_l_mm": [0.8 * rp_mm, 1.3 * rp_mm]},
            "noise_floor": {"rp_l_mm": 0.004},
            "accuracy": None,
        }
        for one in commanded
    ]
    document = {
        "format": "gridpose-report",
        "format_version": 1,
        "report_id": changes.get("report", f"rep_{number:026d}"),
        "kind": "repeatability",
        "made_at": day(number),
        "source": changes.get("source", "images"),
        "subject": {
            "session": {
                "id": changes.get("session", f"ses_{number:026d}"),
                "name": changes.get("name", f"week {number}"),
            },
            "first_captured_at": changes.get("captured_at", day(number)),
        },
        "inputs": {
            "robot": {"id": changes.get("robot", ROBOT)},
            "session": {"conditions": conditions, **changes.get("session_inputs", {})},
            "poses": commanded,
            **changes.get("inputs", {}),
        },
        "analyses": {"repeatability": {"poses": found, "distances": changes.get("distances")}},
    }
    return json.dumps(document).encode()


def joint_content(number: int = 1, **changes: Any) -> bytes:
    """The JSON form of a report on kinematics: a_mm of joint 2, half a millimetre from the data sheet."""
    joint = {
        **dict.fromkeys(("alpha_deg", "d_mm", "theta_offset_deg", "beta_deg")),
        **{"joint": 2, "a_mm": 600.5, "nominal": {"a_mm": 600.0}},
        **{"identifiable": {"a_mm": True}, "standard_uncertainty": {"a_mm": 0.1}},
    }
    document = json.loads(content(number, **changes))
    return json.dumps({**document, "kind": "kinematics", "analyses": {"dh": {"joints": [joint]}}}).encode()


def filed(number: int = 1, **changes: Any) -> Summary:
    """What is read of it."""
    return read_report(content(number, **changes))


def store_filed(api: Api, contents: Iterable[bytes]) -> None:
    """Store reports as made, with nothing but their JSON forms."""
    now = datetime.now(UTC)
    with api.installation.database.write() as records:
        for one in contents:
            document = json.loads(one)
            records.add(
                Report(
                    id=document["report_id"],
                    session_id=document["subject"]["session"]["id"],
                    kind=document["kind"],
                    title="Filed",
                    signatories=[],
                    paper="a4",
                    status="running",
                    attempts=1,
                    created_at=now,
                )
            )
        records.flush()
        for one in contents:
            document = json.loads(one)
            sha256 = hashlib.sha256(one).hexdigest()
            form = {"form": "json", "content": zlib.compress(one), "sha256": sha256, "bytes": len(one)}
            records.add(ReportForm(report_id=document["report_id"], **form))
            row = records.get_one(Report, document["report_id"])
            row.status, row.finished_at = "succeeded", now
