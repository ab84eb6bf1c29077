"""`gridpose worker`: compute queued images without HTTP, until SIGTERM or Ctrl-C."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from types import FrameType

from app.cli.context import load_settings, open_context, print_location, warn_of_unknown_settings
from app.cli.options.data_folder import DataDir
from app.cli.server.exclusion import require_no_runner
from app.cli.server.supervision import Supervisor, end_after_giving_up
from app.client.commands import fail
from app.logs import configure_logging
from app.records.file_lock import AlreadyLocked

_POLL_S = 0.1


class StopRequested:
    """A signal handler that is true once it was called.

    It takes no lock: it runs in the thread that waits for it, which may hold the lock.
    """

    def __init__(self) -> None:
        self._called = False

    def __call__(self, _number: int, _frame: FrameType | None) -> None:
        self._called = True

    def __bool__(self) -> bool:
        return self._called


def work(data_dir: DataDir = None) -> int:
    """Compute queued images without serving HTTP."""
    settings = load_settings(data_dir=data_dir)
    if settings.worker_count == 0:
        fail(
            "GRIDPOSE_WORKERS=0 leaves nothing to do.",
            "Set it to the number of processes, or unset it.",
            code=2,
        )
    configure_logging(settings.log_level)
    warn_of_unknown_settings()
    print_location(settings)
    require_no_runner(settings)
    installation = open_context(settings, migrate=True, serves=False)
    stop_requested = StopRequested()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop_requested)
    supervisor = Supervisor.from_environment(os.environ)
    runner = installation.runner()
    try:
        runner.start()
    except AlreadyLocked:
        installation.close()
        fail(
            f"Another process computes the images of {settings.data_dir} or its database.",
            "Stop that process first.",
        )
    with contextlib.suppress(OSError):  # stderr may be on a full disk, and is not needed to compute
        print(f"computing with {settings.worker_count} processes on {settings.data_dir}", file=sys.stderr)
    try:
        while not runner.given_up and not stop_requested:
            supervisor.beat(ready=runner.state.ready > 0)
            time.sleep(_POLL_S)
        gave_up = not stop_requested
        if gave_up:
            end_after_giving_up()
        supervisor.stopping()
    finally:
        installation.database.patience.end_within()
        runner.stop()
        installation.close()
    return 1 if gave_up else 0
