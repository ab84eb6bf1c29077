"""The bare reference of an upload: Starlette and nothing else. `python -m benchmarks.service.reference FOLDER`.

One route streams a body to a temporary file, hashes it, brings it to the disk, renames it and inserts one row, all on
the event loop. It has no keys, no checks, no log, no metrics; its database is SQLite as the service opens it.
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Self

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from app.records.database import sqlite_driver


def application(folder: Path) -> Starlette:
    """Return the application; files and database lie in `folder`."""
    module, _ = sqlite_driver()
    database = module.connect(str(folder / "bare.sqlite3"), isolation_level=None)
    for statement in (
        "PRAGMA journal_mode=WAL",
        "PRAGMA synchronous=FULL",
        "CREATE TABLE IF NOT EXISTS images (sha256 TEXT PRIMARY KEY, pose_id TEXT, bytes INTEGER, at REAL)",
    ):
        database.execute(statement)

    async def put(request: Request) -> Response:
        temporary = folder / secrets.token_hex(16)
        digest, size = hashlib.sha256(), 0
        with temporary.open("xb", buffering=0) as file:
            async for chunk in request.stream():
                file.write(chunk)
                digest.update(chunk)
                size += len(chunk)
            os.fsync(file.fileno())
        sha256 = digest.hexdigest()
        if sha256 != request.path_params["sha256"]:
            temporary.unlink()
            return Response(status_code=422)
        temporary.replace(folder / sha256)
        row = (sha256, request.path_params["pose"], size, time.time())
        database.execute("INSERT INTO images VALUES (?, ?, ?, ?)", row)
        return Response(json.dumps({"sha256": sha256}), 202, media_type="application/json")

    return Starlette(routes=[Route("/images/{pose}/{sha256}", put, methods=["PUT"])])


class ReferenceProcess:
    """The reference in a process of its own, on a free port of the loopback address."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True)
        command = [sys.executable, "-m", "benchmarks.service.reference", str(folder)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.port = int(self.process.stdout.readline())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.process.terminate()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


def main() -> None:
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listener.bind(("127.0.0.1", 0))
    listener.listen(128)
    print(listener.getsockname()[1], flush=True)
    # The protocol and the loop that the service uses: the ratio is that of the applications.
    config = uvicorn.Config(
        application(Path(sys.argv[1])), http="h11", loop="asyncio", access_log=False, log_level="warning"
    )
    uvicorn.Server(config).run(sockets=[listener])


if __name__ == "__main__":
    main()
