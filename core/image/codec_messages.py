"""What the libraries that decode images write to stderr, kept out of it.

libjpeg, libpng and libtiff write an opinion of damaged files to the process's stderr, past every handler of ours. What
they find is judged by us: the file is refused, or shown as far as it goes. Their lines become debug lines of this
module's logger; whatever else is written meanwhile, by other threads or by a library that fails, is passed on.
"""

from __future__ import annotations

import logging
import os
import re
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_STDERR = 2
_OF_CODECS = re.compile(
    rb"Corrupt JPEG data|Premature end of JPEG|Invalid (SOS|component|JPEG)|Unsupported marker|Unknown Adobe|"
    rb"Inconsistent progression|Warning: unknown JFIF|Application transferred too many scanlines|"
    rb"libpng (warning|error):|TIFF\w*: "
)
_log = logging.getLogger(__name__)
_lock = threading.Lock()
_open: list[tuple[int, int]] = []
"""While a file is decoded: the real stderr and the file in its place. Empty otherwise."""
_users = 0


@contextmanager
def codec_messages_logged() -> Iterator[None]:
    """Send what codecs write to stderr to the logger at level debug, and everything else to stderr afterwards."""
    _begin()
    try:
        yield
    finally:
        _end()


def _begin() -> None:
    """Put a file in the place of stderr; threads that decode at the same time share it."""
    global _users
    with _lock:
        _users += 1
        if _users > 1:
            return
        try:
            real = os.dup(_STDERR)
        except OSError:  # the process has no stderr, so that nothing can reach it
            return
        try:
            with tempfile.TemporaryFile() as file:
                kept = os.dup(file.fileno())
        except OSError:  # no room for a file: the lines are a nuisance, not a fault
            os.close(real)
            return
        os.dup2(kept, _STDERR)
        _open.append((real, kept))


def _end() -> None:
    """Restore stderr once nobody decodes, and distribute what was written meanwhile."""
    global _users
    with _lock:
        _users -= 1
        if _users or not _open:
            return
        real, kept = _open.pop()
        os.dup2(real, _STDERR)
        os.close(real)
        size = os.lseek(kept, 0, os.SEEK_END)
        os.lseek(kept, 0, os.SEEK_SET)
        written = os.read(kept, size) if size else b""
        os.close(kept)
    others = []
    for line in written.splitlines(keepends=True):
        if _OF_CODECS.search(line):
            _log.debug("%s", line.decode(errors="replace").rstrip())
        else:
            others.append(line)
    if others:
        os.write(_STDERR, b"".join(others))
