"""Analyses of stored sessions: repeatability over 10,000 measurements, answers that are known, pages, pooled fits."""

from __future__ import annotations

import math
import re
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from statistics import median

import httpx2
import numpy as np

from app.analyses.worker import analyse
from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from app.records.database import Database
from app.settings import Settings
from benchmarks.conditions import one_core, seconds
from benchmarks.stored.visits import Visit, store
from benchmarks.table import Row
from core.calibration import calibrate_views
from core.geometry import invert, project, so3_exp, transform, transform_points
from core.targets import GridPoints, TargetSpec
from tests.support.simulation.simulated_views import draw_camera, draw_pose, draw_view

WIDTH, HEIGHT = 2448, 2050
SIGMA_PX = 0.05
REPEATABILITY_MM = 0.05
STORED = 10_000


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    yield from _pooled_fit(seeds, 3 if quick else 15)
    cases = [((14, 10), 50), ((14, 10), 5), ((9, 6), 50), ((9, 6), 5)]
    for board, poses in cases[:1] if quick else cases:
        yield from _stored(board, poses, seeds[0], 3 if quick else 7)


def _pooled_fit(seeds: list[int], repeats: int) -> Iterable[Row]:
    sets = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        camera = draw_camera(rng)
        sets.append(
            [
                draw_view(rng, columns=25, rows=18, tilt_deg=rng.uniform(10.0, 45.0), camera=camera).points
                for _ in range(150)
            ]
        )
    with one_core():
        calibrate_views(sets[0])
        times = [seconds(lambda v=views: calibrate_views(v)) for _ in range(repeats) for views in sets]
        started = time.process_time()
        for views in sets:
            calibrate_views(views)
        processor = (time.process_time() - started) / len(sets)
    best = f"best {1e3 * min(times):.0f} ms"
    note = f"starts and covariance included; {len(times)} fits, one core, median ({best})"
    yield Row.at_most("pooled fit, 150 images x 450 points", 1e3 * median(times), 75.0, "ms", note)
    yield Row.context("the same, processor time", 1e3 * processor, "ms", f"mean of {len(sets)}")


def _stored(board: tuple[int, int], poses: int, seed: int, repeats: int) -> Iterable[Row]:
    """Ask a service of its own for a session's table: computed, kept, unchanged, and a page of its measurements."""
    case = f"{poses} poses x {STORED // poses} cycles, {board[0]}x{board[1]}"
    with tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name:
        folder = Path(name)
        with ServiceProcess(folder, {"GRIDPOSE_WORKERS": "0"}) as service:
            assert service.admin_key is not None
            with ServiceClient(service.url, service.admin_key) as client:
                session_id, target_id = new_session(client, board)
            store(folder, session_id, target_id, stored_visits(board, poses, seed))
            headers = {"Authorization": f"Bearer {service.admin_key}"}
            with httpx2.Client(base_url=service.url, headers=headers, timeout=200.0) as client:
                yield from _asked(client, session_id, case, repeats)
            yield from _shown(service.url, service.admin_key, session_id, case, repeats)
        yield _alone(folder, session_id, case, repeats)


def _asked(client: httpx2.Client, session_id: str, case: str, repeats: int) -> Iterable[Row]:
    address = f"/v1/sessions/{session_id}"

    def get(path: str, **headers: str) -> tuple[float, httpx2.Response]:
        started = time.perf_counter()
        response = client.get(address + path, headers=headers)
        taken = time.perf_counter() - started
        assert response.status_code in (200, 304), response.text
        return taken, response

    get("/intrinsics")  # the process that computes is started and loaded
    computed: list[float] = []
    for repeat in range(repeats):
        # The commanded position of one pose differs each time, so that no cached answer applies.
        pose = {"position_mm": [float(repeat), 0.0, 0.0]}
        assert client.put(f"{address}/poses/P1", json=pose).status_code == 200
        taken, response = get("/repeatability")
        computed.append(taken)
    tag = {"If-None-Match": response.headers["ETag"]}
    kept = [get("/repeatability")[0] for _ in range(5 * repeats)]
    unchanged = [get("/repeatability", **tag)[0] for _ in range(5 * repeats)]
    pages = []
    cursor = ""
    for _ in range(5 * repeats):
        taken, response = get(f"/measurements?limit=50{cursor}")
        pages.append(taken)
        cursor = f"&cursor={response.json()['next_cursor']}"
    note = f"by HTTP, {case}; median of {repeats} (best {min(computed):.2f} s)"
    yield Row.at_most("repeatability over 10,000 stored measurements", median(computed), 1.0, "s", note)
    how = f"by HTTP, {case}; median of {5 * repeats}"
    yield Row.context("the same again, kept", 1e3 * median(kept), "ms", how)
    yield Row.context("the same again, 304", 1e3 * median(unchanged), "ms", how)
    yield Row.at_most("a page of 50 of 10,000 measurements", 1e3 * median(pages), 20.0, "ms", how)


def _shown(url: str, key: str, session_id: str, case: str, repeats: int) -> Iterable[Row]:
    """Load the dashboard's first page, and that of the session, as a browser that is signed in."""
    with httpx2.Client(base_url=url, timeout=60.0, follow_redirects=True) as browser:
        token = re.search(r'name="csrf_token" value="(\w+)"', browser.get("/ui/sign-in").text)
        assert token is not None
        browser.post("/ui/sign-in", data={"csrf_token": token[1], "key": key})

        def load(path: str) -> float:
            started = time.perf_counter()
            response = browser.get(path)
            taken = time.perf_counter() - started
            assert response.status_code == 200, response.text
            return taken

        how = f"by HTTP, {case}; median of {5 * repeats}"
        for name, path, goal_ms in (
            ("first page", "/ui/", 150.0),
            ("page of a session of 10,000", f"/ui/sessions/{session_id}", 300.0),
            ("the last page of its images", f"/ui/sessions/{session_id}?page=167", 300.0),
        ):
            load(path)
            times = [load(path) for _ in range(5 * repeats)]
            yield Row.at_most(f"dashboard: {name}", 1e3 * median(times), goal_ms, "ms", how)


def _alone(folder: Path, session_id: str, case: str, repeats: int) -> Row:
    """Compute the table in this process: under other load, processor time is more reliable than elapsed time."""
    database = Database(Settings(data_dir=folder).effective_database_url)
    settings = {"estimator": "pooled", "source": "images"}
    times = []
    for _ in range(repeats + 1):
        started = time.process_time()
        analyse(database, "repeatability", session_id, settings)
        times.append(time.process_time() - started)
    database.dispose()
    note = f"reading included, without HTTP, {case}; best of {repeats}, threads added up"
    return Row.context("the same, processor time", min(times[1:]), "s", note)


def new_session(client: ServiceClient, board: tuple[int, int]) -> tuple[str, str]:
    """Return the ids of a new session and of its target, a chessboard."""
    target = {"name": "board", "kind": "chessboard", "columns": board[0], "rows": board[1], "pitch_mm": 10.0}
    target_id: str = client.create("/v1/targets", target)["id"]
    session_id: str = client.create("/v1/sessions", {"name": "bench", "target_ids": [target_id]})["id"]
    return session_id, target_id


def stored_visits(board: tuple[int, int], poses: int, seed: int) -> Iterator[Visit]:
    """Yield what a detector reports of a robot whose positions scatter; its uncertainties scatter by 3 %, too."""
    rng = np.random.default_rng(seed)
    target = TargetSpec("chessboard", board[0], board[1], 10.0)
    camera = draw_camera(rng)
    row, column = (a.ravel() for a in np.mgrid[0 : board[1], 0 : board[0]])
    commanded = [
        invert(draw_pose(rng, target, camera, WIDTH, math.radians(rng.uniform(20.0, 40.0))))
        for _ in range(poses)
    ]
    for cycle in range(1, STORED // poses + 1):
        for index, T in enumerate(commanded):
            d, w = rng.normal(0.0, REPEATABILITY_MM, 3), rng.normal(0.0, 1e-3 * REPEATABILITY_MM, 3)
            attained = invert(transform(so3_exp(w) @ T[:3, :3], T[:3, 3] + d))
            exact = project(transform_points(attained, target.points_target()), camera)
            noisy = exact + rng.normal(0.0, SIGMA_PX, exact.shape)
            u = SIGMA_PX * np.exp(rng.normal(0.0, 0.03, len(exact)))
            points = GridPoints(target, WIDTH, HEIGHT, column, row, noisy, u)
            yield Visit(f"P{index + 1}", cycle, points)
