"""What a command writes elsewhere than in the data folder: whose failure it is where the system refuses something."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from app.errors import OperationRefused

_OF_WRITING = {errno.ENOSPC, errno.EROFS, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)}
"""What a write alone is refused with, which names no file: such a command writes to its own place only."""


@contextmanager
def output_failures(
    data_dir: Path, refusal: Callable[[Path | None, str], OperationRefused]
) -> Iterator[None]:
    """Raise `refusal` where the system refuses what does not concern the data folder.

    It is called with the file, where the error names one, and with what the system said.
    """
    try:
        yield
    except OSError as error:
        named = Path(os.fsdecode(error.filename)) if isinstance(error.filename, str | bytes) else None
        of_data = named is not None and named.absolute().is_relative_to(data_dir.absolute())
        if of_data or (named is None and error.errno not in _OF_WRITING):
            raise
        raise refusal(named, error.strerror or str(error)) from error
