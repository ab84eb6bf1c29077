"""`gridpose worker`: computes queued images, with no HTTP, until SIGTERM or Ctrl-C."""

from __future__ import annotations

import signal
import threading
from pathlib import Path

from app.cli.configuration import fail, load_settings, open_installation
from app.cli.serve import require_free_folder
