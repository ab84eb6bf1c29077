"""Memory of the process that takes uploads: as much after twenty thousand of them as after the first thousands."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterable
from pathlib import Path

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from benchmarks.service.connection import measurement_route, variant
from benchmarks.service.processor_time import TARGET, small_jpeg
from benchmarks.service.throughput import new_session
from benchmarks.table import Row

UPLOADS = 20_000
MAX_GROWTH_MIB = 8.0
"""From a quarter of the uploads to the last: caches that are full have their size, and everything is loaded."""
_RESIDENT = re.compile(r"VmRSS:\s+(\d+) kB")


def memory_rows(seed: int, quick: bool) -> Iterable[Row]:
    """Measure what a service without workers holds in memory while one client sends small images."""
    uploads = 1000 if quick else UPLOADS
    image = small_jpeg(seed)
    with (
        tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name,
        ServiceProcess(Path(name) / "data", {"GRIDPOSE_WORKERS": "0"}) as service,
    ):
        with ServiceClient(service.url, service.admin_key) as client:
            session_id = new_session(client, TARGET)
        assert service.admin_key is not None
        route = measurement_route(service.url, session_id, service.admin_key)
        connection = route.connect()
        held = []
        for number in range(uploads):
            if number == uploads // 4:
                held.append(resident_mib(service.process.pid))
            route.send(connection, variant(image, number))
        held.append(resident_mib(service.process.pid))
        connection.close()
    early, late = held
    note = f"from {early:.0f} to {late:.0f} MiB, from upload {uploads // 4:,} to {uploads:,}"
    yield Row.at_most("memory that uploads add", late - early, MAX_GROWTH_MIB, "MiB", note)


def resident_mib(pid: int) -> float:
    """Return the memory that a process holds, MiB. Linux only."""
    found = _RESIDENT.search(Path(f"/proc/{pid}/status").read_text(encoding="ascii"))
    assert found is not None, "the process has ended"
    return int(found[1]) / 1024.0
