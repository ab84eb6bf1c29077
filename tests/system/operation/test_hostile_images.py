"""An upload of any content neither grows the service's process nor keeps others waiting."""

from __future__ import annotations

import hashlib
import os
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx2
import pytest

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from tests.support.image.hostile_headers import empty_chunks, empty_segments, greedy_tiff
from tests.support.image.image_encoders import GREY_PALETTE, bmp
from tests.support.service.service import new_session

MIB = 1 << 20
MOST_GROWTH_BYTES = 64 * MIB
MOST_SECONDS = 0.5
TRIES = 3
"""A busy machine keeps anyone waiting once in a while, and a file that costs too much does so every time."""
BYTE, LONG = 1, 4

HOSTILE: dict[str, Callable[[], bytes]] = {
    "TIFF of 2 MiB": lambda: greedy_tiff(2 * MIB),
    "TIFF of 4 MiB": lambda: greedy_tiff(4 * MIB),
    "TIFF of 4 MiB, bytes": lambda: greedy_tiff(4 * MIB, kind=BYTE),
    "TIFF of 4 MiB, from the high end": lambda: greedy_tiff(4 * MIB, order=">", kind=LONG),
    "BigTIFF of 4 MiB": lambda: greedy_tiff(4 * MIB, big=True),
    "BigTIFF of 4 MiB, from the high end": lambda: greedy_tiff(4 * MIB, order=">", big=True, kind=LONG),
    "JPEG of 8 MiB of empty segments": lambda: empty_segments(8 * MIB),
    "JPEG of 8 MiB of fill bytes": lambda: empty_segments(8 * MIB, b"\xff"),
    "JPEG of 64 MiB of empty segments": lambda: empty_segments(64 * MIB),
    "PNG of 8 MiB of empty chunks": lambda: empty_chunks(8 * MIB),
    "PNG of 8 MiB of other empty chunks": lambda: empty_chunks(8 * MIB, name=b"abCd"),
}

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/clear_refs").exists(), reason="needs /proc to see a process's memory"
)


@dataclass(frozen=True)
class Cost:
    """What one upload took of the service, and the longest anyone waited for `/livez` meanwhile."""

    status: int
    grown_bytes: int
    processor_s: float
    livez_s: float


class Measured:
    """A running service whose cost per upload is measured."""

    def __init__(self, service: ServiceProcess) -> None:
        self._url, self._pid = service.url, service.process.pid
        self._headers = {"Authorization": f"Bearer {service.admin_key}"}
        with ServiceClient(service.url, service.admin_key) as client:
            self._session_id = new_session(client)

    def upload(self, data: bytes) -> Cost:
        """Send a file once and see what it takes; then once more, and see how long others wait."""
        before_bytes, before_s = self._forget_peak(), self._processor_s()
        status = self._put(data)
        processor_s, grown = self._processor_s() - before_s, self._memory("VmHWM") - before_bytes
        return Cost(status, grown, processor_s, self._longest_livez_s(data + b"\0"))

    def _put(self, data: bytes) -> int:
        address = (
            f"{self._url}/v1/sessions/{self._session_id}/poses/P1/images/{hashlib.sha256(data).hexdigest()}"
        )
        headers = {**self._headers, "Content-Type": "application/octet-stream"}
        return httpx2.put(address, content=data, headers=headers, timeout=120.0).status_code

    def _longest_livez_s(self, data: bytes) -> float:
        upload = threading.Thread(target=self._put, args=(data,))
        longest = 0.0
        with httpx2.Client(base_url=self._url, timeout=120.0) as client:
            client.get("/livez")
            upload.start()
            while upload.is_alive():
                began = time.monotonic()
                assert client.get("/livez").status_code == 200
                longest = max(longest, time.monotonic() - began)
        upload.join()
        return longest

    def _forget_peak(self) -> int:
        Path(f"/proc/{self._pid}/clear_refs").write_text("5", encoding="ascii")
        return self._memory("VmHWM")

    def _memory(self, name: str) -> int:
        status = Path(f"/proc/{self._pid}/status").read_text(encoding="ascii")
        return 1024 * int(status.split(f"{name}:")[1].split()[0])

    def _processor_s(self) -> float:
        user, system = Path(f"/proc/{self._pid}/stat").read_text().rpartition(")")[2].split()[11:13]
        return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Measured]:
    """A service without workers: what its own process does is what is measured."""
    folder = tmp_path_factory.mktemp("hostile") / "data"
    with ServiceProcess(folder, {"GRIDPOSE_WORKERS": "0", "GRIDPOSE_DISK_FLOOR_BYTES": "0"}) as service:
        found = Measured(service)
        found.upload(plain_image(1 * MIB))
        yield found


def plain_image(size: int) -> bytes:
    """Return a BMP of about `size` bytes."""
    width = 4096  # so that no side is too long to be taken
    rows = size // width
    data = bmp(8, 0, bytes(width * rows), width, rows, GREY_PALETTE)
    return data + secrets.token_bytes(8)  # new to the service each time


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_costs_no_more_than_a_plain_one(
    measured: Measured, name: str, record_property: Callable[[str, object], None]
) -> None:
    data = HOSTILE[name]()
    for attempt in range(TRIES):
        plain = measured.upload(plain_image(len(data)))
        hostile = measured.upload(data + b"\1" * attempt)  # new to the service each time
        record_property("plain", str(plain))
        record_property("hostile", str(hostile))
        print(f"{name}: {hostile}, plain: {plain}")
        if is_as_quick(hostile, plain):
            break
    assert plain.status == 202
    assert hostile.status in (202, 415, 422)
    assert hostile.grown_bytes <= plain.grown_bytes + MOST_GROWTH_BYTES
    assert is_as_quick(hostile, plain), (hostile, plain)


def is_as_quick(hostile: Cost, plain: Cost) -> bool:
    """Whether a hostile file took about as much of the processor, and of others' patience, as a plain one."""
    return (
        hostile.processor_s <= plain.processor_s + MOST_SECONDS
        and hostile.livez_s <= 2 * plain.livez_s + MOST_SECONDS
    )
