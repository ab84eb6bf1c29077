"""An installation that its user may only read, as in a container: what was compiled with it is used."""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from core import TargetSpec
from core.simulation import render
from tests.support.simulation.scenes import standard_scene

PROJECT = Path(__file__).parents[3]
RUN = """
import hashlib, json, os, sys, time
from pathlib import Path
import app
from app.client import ServiceClient
from app.cli.demo.service_process import ServiceProcess

tree, data_dir, image = Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]).read_bytes()
assert Path(app.__file__).is_relative_to(tree)
started = time.monotonic()
with ServiceProcess(data_dir, {"GRIDPOSE_WORKERS": "1"}) as service:
    ready_s = time.monotonic() - started
    with ServiceClient(service.url, service.admin_key) as client:
        target = {"name": "board", "kind": "chessboard", "columns": 9, "rows": 6, "pitch_mm": 25.0}
        target_id = client.create("/v1/targets", target)["id"]
        session_id = client.create("/v1/sessions", {"name": "s", "target_ids": [target_id]})["id"]
        sha256 = hashlib.sha256(image).hexdigest()
        measurement_id = client.put_image(session_id, "P1", sha256, image)["id"]
        while (found := client.get(f"/v1/measurements/{measurement_id}"))["status"] in ("queued", "running"):
            time.sleep(0.02)
    result_s = time.monotonic() - started - ready_s
print(json.dumps({
    "writable": os.access(tree / "core", os.W_OK),
    "status": found["status"],
    "ready_s": ready_s,
    "result_s": result_s,
    "compiled": [path.name for path in data_dir.rglob("*.nbc")],
}))
"""


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """A copy of the program with its kernels compiled, as the end of an installation leaves it, made read-only."""
    tree = tmp_path / "installed"
    for package in ("app", "core", "migrations"):
        shutil.copytree(PROJECT / package, tree / package)
    compile_kernels = [sys.executable, "-m", "app.jobs.warm_up"]
    done = subprocess.run(
        compile_kernels, env=environment(tree), cwd=tree, check=True, capture_output=True, text=True
    )
    count, total = done.stdout.split("compiling kernels ")[-1].split(" of ")
    assert int(count) == int(total) > 50
    for path in [tree, *tree.rglob("*")]:
        path.chmod(path.stat().st_mode & 0o555)
    return tree


def environment(tree: Path) -> dict[str, str]:
    variables = {**os.environ, "PYTHONPATH": str(tree), "PYTHONSAFEPATH": "1"}
    variables.pop("NUMBA_CACHE_DIR", None)
    return variables


def obey_permissions() -> None:
    """Give up root's right to write everywhere, for the process that is about to start."""
    if os.geteuid() == 0:
        for capability in (1, 2):  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH
            ctypes.CDLL(None).prctl(24, capability, 0, 0, 0)  # PR_CAPBSET_DROP


@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux's capabilities")
def test_a_read_only_installation_compiles_nothing_and_is_ready_to_compute(
    installed: Path, tmp_path: Path
) -> None:
    scene = standard_scene(TargetSpec("chessboard", 9, 6, 25.0), seed=1, tilt=0.5, clutter=0.0)
    image = tmp_path / "image.png"
    assert cv2.imwrite(str(image), render(scene))
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(installed), str(tmp_path / "data"), str(image)],
        env=environment(installed),
        cwd=tmp_path,
        preexec_fn=obey_permissions,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert not found["writable"]
    assert found["status"] == "succeeded"
    assert found["compiled"] == []
    assert found["result_s"] < found["ready_s"] + 10.0  # what is slow comes before the service is ready
