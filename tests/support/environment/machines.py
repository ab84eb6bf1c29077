"""Services and workers as processes of their own, each with a data folder, on one database and bucket."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import httpx2

from app.cli.demo.service_process import ServiceProcess
from app.services.installation.context import ServiceContext
from app.services.keys import create_key
from app.settings import Settings
from tests.support.service.service import OCTETS, TARGET


class Worker:
    """`gridpose worker` with `processes` processes."""

    def __init__(self, folder: Path, environment: Mapping[str, str], processes: int = 1) -> None:
        self._folder = folder
        self._environment = {**os.environ, **environment, "GRIDPOSE_WORKERS": str(processes)}
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        self._folder.mkdir(exist_ok=True)
        command = [sys.executable, "-m", "app.cli", "worker", "--data-dir", str(self._folder / "data")]
        with (self._folder / "log").open("ab") as log:
            self._process = subprocess.Popen(command, env=self._environment, stdout=log, stderr=log)

    def kill(self) -> None:
        assert self._process is not None
        self._process.kill()
        self._process.wait()

    def stop(self) -> int:
        assert self._process is not None
        self._process.terminate()
        try:
            return self._process.wait(40)
        except subprocess.TimeoutExpired:
            self.kill()
            raise


class Machines:
    """An installation of several machines; `of_workers` is what workers have in their environment in addition."""

    def __init__(
        self,
        folder: Path,
        environment: Mapping[str, str],
        *,
        heads: int,
        workers: int,
        processes: int = 1,
        of_workers: Mapping[str, str] | None = None,
    ) -> None:
        folder.mkdir(exist_ok=True)
        self.heads = [
            ServiceProcess(folder / f"head-{n}", {**environment, "GRIDPOSE_WORKERS": "0"})
            for n in range(heads)
        ]
        self.workers = [
            Worker(folder / f"worker-{n}", {**environment, **(of_workers or {})}, processes)
            for n in range(workers)
        ]
        settings = Settings(
            data_dir=folder / "admin",
            database_url=environment["GRIDPOSE_DATABASE_URL"],
            key_pepper=environment["GRIDPOSE_KEY_PEPPER"],  # type: ignore[arg-type]
            workers=0,
        )
        admin = ServiceContext.open(settings)
        self.key = create_key(admin, "admin", "admin").secret_key
        admin.close()
        self.headers = {"Authorization": f"Bearer {self.key}"}

    def start(self) -> None:
        for worker in self.workers:
            worker.start()
        for head in self.heads:
            head.start()

    def stop(self) -> None:
        for head in self.heads:
            head.stop()
        for worker in self.workers:
            worker.stop()

    def make_session(self) -> str:
        with self.client() as client:
            target = client.post("/v1/targets", json=TARGET).json()["id"]
            made = client.post("/v1/sessions", json={"name": "s", "target_ids": [target]})
            return str(made.json()["id"])

    def client(self, number: int = 0) -> httpx2.Client:
        return httpx2.Client(base_url=self.heads[number].url, headers=self.headers, timeout=60.0)

    def counts(self, session_id: str) -> dict[str, int]:
        with self.client() as client:
            counts: dict[str, int] = client.get(f"/v1/sessions/{session_id}").json()["counts"]
            return counts


class Uploads:
    """Images sent in the background to all services in turn, each until it is acknowledged."""

    def __init__(
        self, machines: Machines, session_id: str, images: Sequence[bytes], *, clients: int = 1
    ) -> None:
        self.acknowledged: dict[str, str] = {}
        """Measurements by the hash of their image."""
        self.waits_s: list[float] = []
        self._machines, self._session_id = machines, session_id
        self._rest = list(reversed(images))
        self._threads = [threading.Thread(target=self._send_all, args=(n,)) for n in range(clients)]
        for thread in self._threads:
            thread.start()

    def join(self) -> None:
        for thread in self._threads:
            thread.join()

    def _send_all(self, number: int) -> None:
        heads = self._machines.heads
        with httpx2.Client(headers={**self._machines.headers, **OCTETS}, timeout=60.0) as client:
            while self._rest:
                try:
                    image = self._rest.pop()
                except IndexError:
                    return
                sha256 = hashlib.sha256(image).hexdigest()
                while True:
                    number += 1
                    url = heads[number % len(heads)].url
                    started = time.monotonic()
                    try:
                        answer = client.put(
                            f"{url}/v1/sessions/{self._session_id}/poses/P1/images/{sha256}", content=image
                        )
                    except httpx2.TransportError:
                        time.sleep(0.05)
                        continue
                    if answer.status_code in (200, 202):
                        self.acknowledged[sha256] = answer.json()["id"]
                        self.waits_s.append(time.monotonic() - started)
                        break
                    assert answer.status_code >= 500, answer.text
                    time.sleep(0.05)
