"""How large a file may be to be read as an image."""

from __future__ import annotations

import errno
import os
from typing import BinaryIO

MAX_FILE_BYTES = 1 << 30
"""Files are sent from memory. The service takes a fraction of this, unless its operator raised the limit."""


def require_readable_size(stream: BinaryIO) -> None:
    """Raise OSError where an open file is larger than any image that is sent."""
    if os.fstat(stream.fileno()).st_size > MAX_FILE_BYTES:
        raise OSError(errno.EFBIG, f"it is larger than {MAX_FILE_BYTES >> 30} GiB, as no image is")
