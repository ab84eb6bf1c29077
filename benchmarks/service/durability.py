"""What a service keeps when it is killed, and what a hostile file takes of its memory."""

from __future__ import annotations

import hashlib
import random
import tempfile
from collections.abc import Iterable
from pathlib import Path

import httpx2

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from benchmarks.table import Row
from tests.support.image.hostile_headers import empty_chunks, empty_segments, greedy_tiff
from tests.support.image.images import small_image
from tests.support.service.service import new_session
from tests.support.service.uploads import Uploaders, finished_measurements

MIB = 1 << 20
MOST_GROWTH_MIB = 64.0


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    yield _lost(seeds[0], *((4, 200) if quick else (20, 2000)))
    yield from _growth()


def _lost(seed: int, kills: int, uploads: int) -> Row:
    """Kill the service while two clients upload, and look for every upload that it acknowledged."""
    moments = random.Random(seed)
    with tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name:
        service = ServiceProcess(Path(name) / "data").start()
        try:
            key = service.admin_key
            assert key is not None
            with ServiceClient(service.url, key) as client:
                session_id = new_session(client)
            shift = Uploaders(
                session_id, key, lambda n: (f"P{n % 7}", small_image(n)), uploads, lambda: service.url
            )
            shift.begin()
            for kill in range(kills):
                shift.wait_for(
                    (kill * uploads) // (kills + 1) + moments.randrange(1, uploads // (2 * kills + 2))
                )
                service.kill()
                service = ServiceProcess(Path(name) / "data").start()
            shift.finish()
            with ServiceClient(service.url, key) as client:
                kept = {(m["pose_id"], m["sha256"]) for m in finished_measurements(client, session_id)}
        finally:
            service.stop()
    lost = len(set(shift.acknowledged) - kept)
    note = f"{len(shift.acknowledged):,} uploads by two clients"
    return Row.at_most(f"acknowledged uploads lost over {kills} kill -9", lost, 0, note=note)


def _growth() -> Iterable[Row]:
    """Measure how far the service's peak memory rises over what it had before each file."""
    if not Path("/proc/self/clear_refs").exists():
        yield Row("growth of the service's memory", "not here", note="needs /proc to see a process's memory")
        return
    files = {
        "TIFF of 4 MiB": greedy_tiff(4 * MIB),
        "BigTIFF of 4 MiB": greedy_tiff(4 * MIB, big=True),
        "JPEG of 64 MiB of empty segments": empty_segments(64 * MIB),
        "PNG of 8 MiB of empty chunks": empty_chunks(8 * MIB),
    }
    settings = {"GRIDPOSE_WORKERS": "0", "GRIDPOSE_DISK_FLOOR_BYTES": "0"}
    with (
        tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name,
        ServiceProcess(Path(name) / "data", settings) as service,
    ):
        assert service.admin_key is not None
        with ServiceClient(service.url, service.admin_key) as client:
            session_id = new_session(client)
        _sent(service, session_id, small_image(0))
        for kind, data in files.items():
            before = _forgotten_peak_mib(service)
            status = _sent(service, session_id, data)
            grown = _peak_mib(service) - before
            what = f"growth of the service's memory, hostile upload, {kind}"
            yield Row.at_most(what, grown, MOST_GROWTH_MIB, "MiB", f"answered {status}")


def _sent(service: ServiceProcess, session_id: str, data: bytes) -> int:
    sha256 = hashlib.sha256(data).hexdigest()
    address = f"{service.url}/v1/sessions/{session_id}/poses/P1/images/{sha256}"
    headers = {
        "Authorization": f"Bearer {service.admin_key}",
        "Content-Type": "application/octet-stream",
    }
    return httpx2.put(address, content=data, headers=headers, timeout=120.0).status_code


def _forgotten_peak_mib(service: ServiceProcess) -> float:
    Path(f"/proc/{service.process.pid}/clear_refs").write_text("5", encoding="ascii")
    return _peak_mib(service)


def _peak_mib(service: ServiceProcess) -> float:
    status = Path(f"/proc/{service.process.pid}/status").read_text(encoding="ascii")
    return int(status.split("VmHWM:")[1].split()[0]) / 1024.0
