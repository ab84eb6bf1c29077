"""What the analyses of ordinary and large sessions cost: repeatability of 150 images, identification of 3,000 poses."""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from itertools import islice
from pathlib import Path
from statistics import median

import httpx2
import numpy as np

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from benchmarks.stored.analyses import new_session, stored_visits
from benchmarks.stored.visits import store
from benchmarks.table import Row
from core.kinematics import ModelChoice, identify
from core.simulation import KR5_ARC
from tests.support.simulation.robots.real_arms import angles_within_limits, measured, real_arm

BOARD = 14, 10
POSES, CYCLES = 5, 30
LARGE = 3000


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    yield _repeatability(seeds[0], 3 if quick else 9)
    yield from _identification(seeds[0])


def _repeatability(seed: int, repeats: int) -> Row:
    """Ask a service of its own for the table of a session, which changes before each question."""
    with tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name:
        folder = Path(name)
        with ServiceProcess(folder, {"GRIDPOSE_WORKERS": "0"}) as service:
            assert service.admin_key is not None
            with ServiceClient(service.url, service.admin_key) as client:
                session_id, target_id = new_session(client, BOARD)
            visits = islice(stored_visits(BOARD, POSES, seed), POSES * CYCLES)
            store(folder, session_id, target_id, visits)
            headers = {"Authorization": f"Bearer {service.admin_key}"}
            address = f"/v1/sessions/{session_id}"
            taken = []
            with httpx2.Client(base_url=service.url, headers=headers, timeout=200.0) as http:
                assert (
                    http.get(f"{address}/repeatability").status_code == 200
                )  # the process that computes is loaded
                for repeat in range(repeats):
                    pose = {"position_mm": [float(repeat), 0.0, 0.0]}
                    assert http.put(f"{address}/poses/P1", json=pose).status_code == 200
                    started = time.perf_counter()
                    assert http.get(f"{address}/repeatability").status_code == 200
                    taken.append(time.perf_counter() - started)
    note = f"by HTTP, {POSES} poses x {CYCLES} cycles, 14x10; median of {repeats} (best {min(taken):.2f} s)"
    return Row.at_most("repeatability of 150 images", median(taken), 1.5, "s", note)


def _identification(seed: int) -> Iterable[Row]:
    for what, folds in (("chain and terms", 0), ("chain, terms and held-out poses", 5)):
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as fresh:
            seconds, peak_mib = fresh.submit(_identify, seed, folds).result()
        note = "processor time, one thread; an arm with gears and compliance, all terms offered"
        yield Row.at_most(f"identification of 3,000 poses: {what}", seconds, 6.0, "s", note)
        note = "a fresh process, whole: interpreter, libraries, the simulated poses"
        yield Row.at_most(f"memory of an identification of 3,000 poses: {what}", peak_mib, 500.0, "MiB", note)


def _identify(seed: int, folds: int) -> tuple[float, float]:
    """Return the processor time of an identification, s, and the peak memory of this process, MiB."""
    rng = np.random.default_rng(seed)
    real = real_arm(rng)
    few, poses = (measured(real, angles_within_limits(rng, count), rng) for count in (100, LARGE))
    identify(few, KR5_ARC, folds=folds, model=ModelChoice.AUTO)  # kernels loaded
    begun = time.process_time()
    identify(poses, KR5_ARC, folds=folds, model=ModelChoice.AUTO)
    seconds = time.process_time() - begun
    status = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    peak = next(line.split()[1] for line in status if line.startswith("VmHWM"))
    return seconds, int(peak) / 1024.0
