"""A PostgreSQL server of a test's own, which may be stopped and started."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest


class Cluster:
    """A PostgreSQL server of one's own, in a folder and on a port of its own."""

    def __init__(self, folder: Path, programs: Path) -> None:
        self._data, self._programs = folder / "cluster", programs
        self._data.mkdir(parents=True)
        with socket.create_server(("127.0.0.1", 0)) as free:
            self._port: int = free.getsockname()[1]
        if os.geteuid() == 0:
            folder.chmod(0o711)
            shutil.chown(self._data, "postgres")
        self._run(
            "initdb", "--auth=trust", "--username=gridpose", "--encoding=UTF8", "--locale=C", "--no-sync"
        )
        self.start("UTC")
        subprocess.run(
            [programs / "createdb", "-h", "127.0.0.1", "-p", str(self._port), "-U", "gridpose", "gridpose"],
            check=True,
        )
        self.url = f"postgresql+psycopg://gridpose@127.0.0.1:{self._port}/gridpose"

    def start(self, time_zone: str) -> None:
        options = f"-h 127.0.0.1 -p {self._port} -k {self._data} -c timezone={time_zone}"
        self._run("pg_ctl", "-l", str(self._data / "log"), "-w", "-o", options, "start")

    def stop(self, mode: str) -> None:
        self._run("pg_ctl", "-m", mode, "-w", "stop")

    def _run(self, program: str, *arguments: str) -> None:
        command: Sequence[str] = [str(self._programs / program), "-D", str(self._data), *arguments]
        if os.geteuid() == 0:
            command = ["runuser", "-u", "postgres", "--", *command]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd="/")


@contextmanager
def own_cluster() -> Iterator[Cluster]:
    """Run a server until the end; skips where PostgreSQL's programs are not installed, unless under CI."""
    programs = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
    if not programs:
        if os.environ.get("CI"):
            pytest.fail("PostgreSQL's own programs are required here")
        pytest.skip("PostgreSQL's own programs (initdb, pg_ctl) are not installed")
    folder = Path(tempfile.mkdtemp(prefix="gridpose-cluster-"))
    try:
        cluster = Cluster(folder, programs[-1].parent)
        yield cluster
        cluster.stop("immediate")
    finally:
        shutil.rmtree(folder, ignore_errors=True)
