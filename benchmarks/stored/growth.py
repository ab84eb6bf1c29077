"""Analyses of sessions of 1,000, 10,000 and 100,000 images: time and memory must grow no faster than their number."""

from __future__ import annotations

import math
import multiprocessing
import resource
import tempfile
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from app.analyses.worker import analyse
from app.cli.demo.service_process import ServiceProcess
from app.cli.demo.session import joint_rows
from app.client import ServiceClient
from app.records.database import Database
from app.settings import Settings
from benchmarks.stored.visits import Visit, store
from benchmarks.table import Row
from core.geometry import Camera, invert, project, rotation_to_rpy, transform_points
from core.kinematics import forward
from core.simulation import KR5_ARC, KR5_ARC_HOME, KR5_ARC_LIMITS, Arm, kr5_arc, sample_viewing_configurations
from core.targets import GridPoints, TargetSpec
from tests.support.sessions.robot_session import SETTINGS

GRID = TargetSpec("chessboard", 6, 5, 40.0)
CAMERA = Camera(2350.0, 2348.0, 1230.0, 1018.0, -0.1, 0.05, 1e-4, -2e-4)
SIZE = (2448, 2050)
SIGMA_PX = 0.05
JITTER = math.radians(0.2)
"""Of every joint at every visit, so that no two visits have the same configuration."""
CYCLES = 20
ANALYSES = ("repeatability", "intrinsics", "camera_poses", "hand_eye", "dh")
LARGEST = {"dh": 20_000}
"""Images that an analysis takes at most."""
MOST_GROWTH = 1.3
"""Of the time per image, from 10,000 to 100,000: n log n makes 1.25 of it."""


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    counts = (500, 1000) if quick else (1000, 10_000, 100_000)
    with tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name:
        folder = Path(name)
        sessions = _stored(folder, counts, seeds[0])
        for analysis in ANALYSES:
            taken = {}
            for count, session_id in zip(counts, sessions, strict=True):
                if count > LARGEST.get(analysis, count):
                    continue
                with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
                    seconds, mib = process.submit(_analysed, folder, analysis, session_id).result()
                taken[count] = seconds
                note = f"processor time of a process that is started; {mib:.0f} MiB at most"
                yield Row.context(f"{analysis}, {count:,} images", seconds, "s", note)
            (few, before), (many, after) = list(taken.items())[-2:]
            growth = after / before * few / many
            what = f"{analysis}, time per image, {many:,} ÷ {few:,} images"
            yield Row.at_most(what, growth, MOST_GROWTH)


def _analysed(folder: Path, analysis: str, session_id: str) -> tuple[float, float]:
    """Return the processor time of one analysis, s, and the most memory that this process had, MiB."""
    database = Database(Settings(data_dir=folder).effective_database_url)
    started = time.process_time()
    result = analyse(database, analysis, session_id, SETTINGS)
    taken = time.process_time() - started
    assert isinstance(result.outcome, bytes), result.outcome
    database.dispose()
    return taken, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _stored(folder: Path, counts: tuple[int, ...], seed: int) -> list[str]:
    """Make a session of each number of images in the folder, of a robot that looks at one grid; return their ids."""
    target = {"name": "board", "kind": "chessboard", "columns": GRID.columns, "rows": GRID.rows}
    sessions = []
    with (
        ServiceProcess(folder, {"GRIDPOSE_WORKERS": "0"}) as service,
        ServiceClient(service.url, service.admin_key) as client,
    ):
        robot_id = client.create("/v1/robots", {"name": "KR5", "joints": joint_rows(KR5_ARC)})["id"]
        target_id = client.create("/v1/targets", {**target, "pitch_mm": GRID.pitch_mm})["id"]
        for count in counts:
            session = {"name": f"{count}", "target_ids": [target_id], "robot_id": robot_id}
            sessions.append(client.create("/v1/sessions", session)["id"])
            poses, visits = _session(count, seed)
            for first in range(0, len(poses), 1000):
                client.put_poses(sessions[-1], poses[first : first + 1000])
            store(folder, sessions[-1], target_id, visits)
    return sessions


def _session(count: int, seed: int) -> tuple[list[dict[str, object]], Iterator[Visit]]:
    """Return the commanded poses and the visits, each to a configuration of its own near that of its pose."""
    rng = np.random.default_rng(seed)
    arm = kr5_arc(rng)
    q = sample_viewing_configurations(
        arm, GRID, CAMERA, SIZE, rng, count // CYCLES, home=KR5_ARC_HOME, limits=KR5_ARC_LIMITS
    )
    poses = []
    for number, T in enumerate(forward(KR5_ARC, q), 1):
        roll, pitch, yaw = np.degrees(rotation_to_rpy(T[:3, :3])).tolist()
        angles = {"roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw}
        poses.append({"pose_id": f"P{number}", "position_mm": T[:3, 3].tolist(), **angles})
    return poses, _visits(arm, q, rng)


def _visits(arm: Arm, q: np.ndarray, rng: np.random.Generator) -> Iterator[Visit]:
    row, column = (a.ravel() for a in np.mgrid[0 : GRID.rows, 0 : GRID.columns])
    for cycle in range(1, CYCLES + 1):
        attained = q + rng.normal(0.0, JITTER, q.shape)
        for number, (angles, T) in enumerate(zip(attained, arm.camera_poses(attained), strict=True), 1):
            exact = project(transform_points(invert(T), GRID.points_target()), CAMERA)
            noisy = exact + rng.normal(0.0, SIGMA_PX, exact.shape)
            points = GridPoints(GRID, *SIZE, column, row, noisy, np.full(len(exact), SIGMA_PX))
            yield Visit(f"P{number}", cycle, points, np.degrees(angles).tolist())
