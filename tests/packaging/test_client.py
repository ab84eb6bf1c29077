"""The client as a package of its own: what it needs, where it runs, and a whole session with nothing else installed."""

from __future__ import annotations

import ast
import csv
import json
import os
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import app.client
from app.cli.demo.evaluation import figures_with_truth
from app.cli.demo.service_process import ServiceProcess
from app.cli.demo.session import BOARD, FLAT, SMALL_POSES, image_files, small_session
from app.client import ServiceClient
from tests.support.environment.fault_proxy import FAULTS, FaultProxy, at_random
from tests.support.environment.shop_floor import ShopFloor
from tests.support.service.service import wait_until
from tests.support.service.watched import WatchedCell
from tests.support.simulation.renders import write_renders

PROJECT = Path(__file__).parents[2]
CLIENT = PROJECT / "app" / "client"
_POSIX_ONLY = {"fcntl", "resource", "pwd", "grp", "termios", "pty", "syslog"}
_POSIX_CALLS = {
    "fork",
    "setsid",
    "getuid",
    "geteuid",
    "killpg",
    "chown",
    "statvfs",
    "uname",
    "mkfifo",
    "SIGKILL",
}
_MAX_MB = 25.0


def project(folder: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))
    return loaded


def test_client_and_service_are_of_one_version() -> None:
    client, service = project(CLIENT)["project"], project(PROJECT)["project"]
    assert (client["name"], service["name"]) == ("gridpose", "gridpose-server")
    assert client["version"] == service["version"] == app.client.__version__
    extras = client["optional-dependencies"]
    assert extras["server"] == [f"gridpose-server=={service['version']}"]
    assert extras["postgres"] == [f"gridpose-server[postgres]=={service['version']}"]
    assert set(client["dependencies"]) <= set(service["dependencies"])
    assert service["entry-points"]["gridpose.service"] == {"main": "app.cli:main"}


def test_the_client_needs_what_it_declares_and_runs_on_windows() -> None:
    names = {
        "yaml" if name.startswith("pyyaml") else name.split(">")[0]
        for name in project(CLIENT)["project"]["dependencies"]
    }
    for source in CLIENT.rglob("*.py"):
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
            found = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level:
                found = [node.module or ""]
            modules = {name.partition(".")[0] for name in found}
            assert modules <= sys.stdlib_module_names | names | {"keyring"}, source
            assert not modules & _POSIX_ONLY, source
            assert not (isinstance(node, ast.Attribute) and node.attr in _POSIX_CALLS), source


@pytest.mark.slow
def test_the_client_is_small(environment: Path) -> None:
    sizes = {}
    for record in environment.parent.rglob("*.dist-info/RECORD"):
        name = record.parent.name.partition("-")[0]
        with record.open(encoding="utf-8", newline="") as rows:
            sizes[name] = sum(
                int(size) for file, _, size in csv.reader(rows) if size and not file.endswith(".pyc")
            )
    for tool in ("pip", "setuptools"):
        sizes.pop(tool, None)
    assert not {"numpy", "scipy", "numba", "opencv_python_headless"} & set(sizes)
    assert sum(sizes.values()) < _MAX_MB * 1e6, sizes


READ_TABLE = """
import json, sys
from gridpose import Gridpose

with Gridpose() as gridpose:
    session = gridpose.session(sys.argv[1])
    assert all(m.measured or m.pose_id == "flat" for m in session.wait())
    table = session.repeatability()
    rows = [[row["pose_id"], row["cycles"], row["repeatability.rp_l_mm"]] for row in table.rows]
    print(json.dumps({"rows": rows, "document": table.document}))
"""


@pytest.fixture
def proxy(service: ServiceProcess) -> Iterator[FaultProxy]:
    with FaultProxy(service.url) as between:
        yield between


@pytest.mark.slow
def test_the_client_alone_watches_the_demo_through_faults_and_reads_the_table(
    environment: Path, service: ServiceProcess, proxy: FaultProxy, tmp_path: Path
) -> None:
    """Images appear while the line cuts, repeats and delays requests; the program is killed, the service away."""
    pc = ShopFloor(environment, tmp_path, proxy.url)
    assert "gridpose[server]" in pc.run("gridpose", "serve", code=2)
    pc.run("gridpose", "login", "--api-key-file", "-", text=service.admin_key)
    kept = tmp_path / "gridpose" / "credentials.json"
    assert os.name == "nt" or kept.stat().st_mode & 0o077 == 0
    demo = small_session(seed=2)
    files = list(image_files(demo.images, tmp_path / "images").items())
    target = f"charuco:{BOARD.columns}x{BOARD.rows}:{BOARD.pitch_mm:g},marker={BOARD.marker_mm:g}"
    watch = ("gridpose", "watch", "images", "--session", "Cell 7", "--settle-s", "0.2", "--poll-s", "0.1")
    watch += ("--target", f"{target},dictionary={BOARD.dictionary}", "--live")
    proxy.plan = at_random(seed=17, share=0.25)

    with pc.start(*watch) as process:
        write_renders(dict(files[:6]))
        wait_until(lambda: len(proxy.stored) >= 3, 120, "images are sent")
        process.kill()
        process.communicate()
    proxy.away = True
    with pc.start(*watch, "--once") as process:
        before = proxy.faults["cut before"]
        write_renders(dict(files[6:]))
        wait_until(lambda: proxy.faults["cut before"] > before, 120, "it asks while the service is away")
        proxy.away = False
        said, errors = process.communicate(timeout=600)
    assert process.returncode == 0, said + errors
    assert min(proxy.faults[fault] for fault in FAULTS) > 0
    session_id = said.split()[-1]
    with ServiceClient(service.url, service.admin_key) as direct:
        proxy.answered.clear()  # answers to a process that was killed were not read
        cell = WatchedCell(tmp_path, session_id, proxy, service.admin_key or "", direct)
        cell.assert_each_image_is_stored_once()
        assert cell.has(len(files))

    read = json.loads(pc.run("python", "-c", READ_TABLE, session_id))
    measured = {pose: cycles for pose, cycles, _ in read["rows"]}
    assert measured == {**dict.fromkeys(SMALL_POSES, demo.cycles), FLAT: 1}
    figures = figures_with_truth(demo, read["document"])
    assert len(figures) == 7 * len(SMALL_POSES)
    for figure in figures:
        assert abs(figure.raw - figure.of_these_cycles) < 1.5 * figure.floor, figure
    lengths = {figure.pose_id: figure.raw for figure in figures if figure.name == "rp_l_mm"}
    assert {pose: rp for pose, _, rp in read["rows"] if pose != FLAT} == lengths
