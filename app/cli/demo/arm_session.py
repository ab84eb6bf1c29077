"""The demo's second session: the arm sweeps its joints before two grids, and the service says how it is built."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.progress import Progress

from app.cli.demo.session import require_sent
from app.client import ClientError, Json, ServiceClient, collect_results, plan_files, upload_files
from core import TargetSpec
from core.geometry import Camera
from core.simulation import Arm, ArmSession, simulate_arm_session

GRID = TargetSpec("chessboard", 9, 6, 30.0)
LENS_MM = 4.5
CAMERA = Camera(650.0, 650.0, 618.0, 509.0, k1=-0.1, k2=0.05)
SIZE_PX = (1224, 1025)
STEPS, FREE = 9, 24
QUICK_STEPS, QUICK_FREE = 7, 6
METHODS = ("cpa", "combined", "global")


@dataclass(frozen=True, slots=True)
class ArmAnswers:
    """What the service made of it: one answer a method, or its refusal where it gave none."""

    session_id: str
    by_method: Mapping[str, Json]
    refusals: Mapping[str, ClientError]


def demo_arm_session(arm: Arm, seed: int, *, quick: bool = False) -> ArmSession:
    """Return what is to be photographed; `quick`: fewer poses."""
    steps, free = (QUICK_STEPS, QUICK_FREE) if quick else (STEPS, FREE)
    return simulate_arm_session(arm, GRID, CAMERA, SIZE_PX, steps=steps, free=free, seed=seed)


def run_arm_session(
    client: ServiceClient, session: ArmSession, robot_id: str, images: Path, progress: Progress
) -> ArmAnswers:
    """Describe two grids, session and poses, upload what lies in a folder, and ask for the DH parameters.

    Raises ClientError where the service refuses an upload, or to identify by method global.
    """
    target_ids = [_describe_grid(client, letter) for letter in "AB"]
    body = {"name": "Demo, kinematics", "target_ids": target_ids, "robot_id": robot_id}
    session_id: str = client.create("/v1/sessions", body)["id"]
    for pose in session.poses:
        angles = np.degrees(pose.joint_angles).tolist()
        client.put(f"/v1/sessions/{session_id}/poses/{pose.pose_id}", {"joint_angles_deg": angles})
    _upload(client, session, session_id, target_ids, images, progress)
    identifying = progress.add_task("identifying", total=len(METHODS))
    answers, refusals = {}, {}
    for method in METHODS:
        try:
            answers[method] = client.get(f"/v1/sessions/{session_id}/dh", method=method)
        except ClientError as refusal:
            if method == "global":
                raise
            refusals[method] = refusal
        progress.advance(identifying)
    return ArmAnswers(session_id, answers, refusals)


def _describe_grid(client: ServiceClient, letter: str) -> str:
    grid = {
        "name": f"Grid {letter}",
        "kind": GRID.kind,
        "columns": GRID.columns,
        "rows": GRID.rows,
        "pitch_mm": GRID.pitch_mm,
    }
    return str(client.create("/v1/targets", grid)["id"])


def _upload(
    client: ServiceClient,
    session: ArmSession,
    session_id: str,
    target_ids: list[str],
    images: Path,
    progress: Progress,
) -> None:
    """Send every image with the grid it shows, and wait for all."""
    shows = {pose.pose_id: pose.target for pose in session.poses}
    files = plan_files(images).images
    sending = progress.add_task("uploading sweeps", total=len(files))
    outcomes = []
    for target, target_id in enumerate(target_ids):
        outcomes += upload_files(
            client,
            session_id,
            [file for file in files if shows[file.pose_id] == target],
            target_id=target_id,
            on_done=lambda outcome: progress.advance(sending),
        )
    require_sent(outcomes)
    computing = progress.add_task("computing sweeps", total=len(files))

    def advance(done: int, of: int) -> None:
        progress.update(computing, completed=done, total=of)

    collect_results(client, session_id, outcomes, on_progress=advance)
