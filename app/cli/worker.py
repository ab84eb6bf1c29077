"""`gridpose worker`: computes queued images, with no HTTP, until SIGTERM or Ctrl-C."""

from __future__ import annotations

import signal
import sys
import threading
from pathlib import Path

from app.cli.configuration import fail, load_settings, open_installation
from app.cli.serve import require_no_runner
from app.logs import configure_logging


def work(data_dir: Path | None) -> int:
    """Run jobs until told to end; return the exit code."""
    settings = load_settings(data_dir=data_dir)
    if settings.worker_count == 0:
        fail(
            "GRIDPOSE_WORKERS=0 leaves nothing to do.",
            "Set it to the number of processes, or unset it.",
            code=2,
        )
    configure_logging(settings.log_level)
    installation = open_installation(settings)
    require_no_runner(settings)
    told_to_end = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: told_to_end.set())
    runner = installation.runner()
    runner.start()
    print(f"computing with {settings.worker_count} processes on {settings.data_dir}", file=sys.stderr)
    try:
        while runner.alive and not told_to_end.wait(1.0):
            pass
        died = not told_to_end.is_set()
    finally:
        runner.stop()
        installation.close()
    return 1 if died else 0
