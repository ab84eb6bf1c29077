"""Sessions to archive, archives taken apart, and archives that somebody made up."""

from __future__ import annotations

import hashlib
import json
import tarfile
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from app.errors import ArchiveRefused
from app.reports.signature import sign_report, signing_key
from app.services import reports
from app.services.archive.container import ArchiveWriter
from app.services.installation.context import ServiceContext
from app.services.qualifications import store_qualification
from tests.support.service.backups import content, image
from tests.support.service.originals import original_path
from tests.support.service.service import Api
from tests.support.sessions.stored_sessions import BOARD, board_fields, shoot, store_shots, with_fields

ROBOT = {
    "name": "arm",
    "joints": [{"a_mm": 0.0, "alpha_deg": 90.0, "d_mm": 400.0, "theta_offset_deg": 0.0}] * 6,
}


OF_INSTALLATION = (
    "installation",
    "api_keys",
    "audit_entries",
    "removals",
    "report_summaries",
    "notices",
    "notice_marks",
)
"""What belongs to no session, and what is made again of what does."""


def store(api: Api) -> str:
    """A session with a robot, its event, images with originals, commanded pose, reading, report and qualification."""
    robot = api.client.post("/v1/robots", json=ROBOT).json()["id"]
    event = {"at": "2026-01-02T03:04:05Z", "note": "Fett \u00e4"}
    assert api.client.post(f"/v1/robots/{robot}/events", json=event).status_code == 201
    target = api.make_target(**board_fields(BOARD))
    session = api.make_session(target, name="Zelle 4 \u00e4", robot_id=robot, camera_mount="fixed")
    for number, shot in enumerate(shoot(poses=2, cycles=2), start=1):
        data = image(number)
        sha256 = hashlib.sha256(data).hexdigest()
        path = original_path(api.installation, sha256)
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
        fields = {"sha256": sha256, "bytes": len(data), "captured_at": datetime(2026, 1, 2, 3, 4, 5, 6, UTC)}
        store_shots(api, session, with_fields([shot], **fields), target)
    pose = {"position_mm": [1.0, 2.0, 0.1 + 0.2]}
    assert api.client.put(f"/v1/sessions/{session}/poses/P1", json=pose).status_code == 200
    reading = [{"pose_id": "P1", "cycle": 1, "position_mm": [1.0, 2.0, 3.0]}]
    assert api.client.post(f"/v1/sessions/{session}/measured-poses", json=reading).status_code < 300
    make_report(api.installation, session, {"json": b"{}", "pdf": b"%PDF-" + bytes(range(256)) * 9})
    figures = {"worst_error_mm": 0.1 + 0.2, "scale_ppm": -3.5, "probing_scatter_mm": 0.02}
    analysis = {**figures, "decision": None, "maximum_permissible_error_mm": None}
    with api.installation.database.write() as records:
        store_qualification(records, session, analysis, valid_days=365, camera_name="C-7")
    return session


def make_report(installation: ServiceContext, session: str, forms: dict[str, bytes]) -> str:
    """Store a signed report without computing one."""
    new = reports.NewReport(kind="session", title="Filed", signatories=[], paper="a4")
    with installation.database.write() as records:
        report_id = reports.order_report(records, session, new).report.id
        records.flush()
        assert reports.claim_next(records) is not None
        manifest = reports.manifest_of(
            report_id=report_id,
            kind="session",
            session_id=session,
            made_at=datetime.now(UTC),
            core_version="1",
            forms=forms,
        )
        reports.save_report(
            records,
            report_id,
            forms=forms,
            signature=sign_report(signing_key(installation.pepper), manifest),
            core_version="1",
            inputs_sha256="0" * 64,
            finished_at=datetime.now(UTC),
        )
    return report_id


def rows(installation: ServiceContext) -> dict[str, Any]:
    return {
        name: found for name, found in content(installation.database).items() if name not in OF_INSTALLATION
    }


def members(archive: Path) -> list[tuple[str, bytes]]:
    with tarfile.open(archive) as tar:
        return [(one.name, tar.extractfile(one).read()) for one in tar]  # type: ignore[union-attr]


def is_untouched(installation: ServiceContext) -> bool:
    folder = installation.settings.data_dir
    left = [path for path in (folder / "originals").glob("*/*") if path.is_file()]
    return not left and not list(folder.glob("restoring*")) and not any(rows(installation).values())


def refused(what: Callable[[], Any]) -> str:
    with pytest.raises(ArchiveRefused) as caught:
        what()
    assert caught.value.advice
    return caught.value.code


def rebuilt(
    archive: Path,
    path: Path,
    change: Callable[[dict[str, Any], dict[str, bytes]], None],
    *,
    names: Callable[[str], str] = lambda name: name,
) -> Path:
    """Write an archive whose content was changed by somebody who signs it with a key of their own."""
    found = dict(members(archive))
    manifest = json.loads(found["manifest.json"])
    change(manifest, found)
    for file in manifest["files"]:
        data = found.get(file["name"], b"")
        file["bytes"], file["sha256"] = len(data), hashlib.sha256(data).hexdigest()
    signed = sign_report(signing_key(b"somebody"), manifest)
    with path.open("wb") as file:
        writer = ArchiveWriter(file, 0)
        writer.add_bytes("README.txt", b"")
        writer.add_bytes("manifest.json", json.dumps(manifest).encode())
        writer.add_bytes("manifest.sig", json.dumps(signed).encode())
        for one in manifest["files"]:
            writer.add_bytes(names(one["name"]), found.get(one["name"], b""))
        writer.close()
    return path


def replace_rows(table: str, old: str, new: str) -> Callable[[dict[str, Any], dict[str, bytes]], None]:
    def change(_manifest: dict[str, Any], found: dict[str, bytes]) -> None:
        name = f"rows/{table}.jsonl"
        text = found[name].decode()
        assert old in text
        found[name] = text.replace(old, new).encode()

    return change


def rename_first(prefix: str, name: str) -> Callable[[dict[str, Any], dict[str, bytes]], None]:
    def change(manifest: dict[str, Any], found: dict[str, bytes]) -> None:
        file = next(file for file in manifest["files"] if file["name"].startswith(prefix))
        found[name] = found[file["name"]]
        file["name"] = name

    return change
