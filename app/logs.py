"""Logging: one JSON object per line on stderr, without secrets."""

from __future__ import annotations

import contextlib
import io
import logging
import sys
import time
from typing import Any, TextIO, cast

_MAX_SUBJECTS = 100
_EVERY_S = 60.0


class Logger:
    """Writes lines with structlog, which it loads for the first: workers and most commands write none, and do without
    20 MB and a tenth of a second.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def info(self, event: str, **fields: Any) -> None:
        """Write what happened in the course of things."""
        self._lines().info(event, **fields)

    def warning(self, event: str, **fields: Any) -> None:
        """Write what somebody should look at some day."""
        self._lines().warning(event, **fields)

    def error(self, event: str, **fields: Any) -> None:
        """Write what was not done."""
        self._lines().error(event, **fields)

    def exception(self, event: str, **fields: Any) -> None:
        """Write what was not done, with the exception that is being handled."""
        self._lines().exception(event, **fields)

    def critical(self, event: str, **fields: Any) -> None:
        """Write what ends the service."""
        self._lines().critical(event, **fields)

    def _lines(self) -> Any:
        import structlog

        return structlog.get_logger(self._name)


class Sparingly:
    """Decides whether what happens again and again is to be logged: the first time, then once a minute."""

    def __init__(self) -> None:
        self._last: dict[str, float] = {}

    def due(self, subject: str) -> bool:
        """Return whether `subject` is to be logged now. Subjects are few: codes, and what a driver says."""
        now = time.monotonic()
        if now - self._last.get(subject, -_EVERY_S) < _EVERY_S:
            return False
        if len(self._last) > _MAX_SUBJECTS:
            self._last.clear()
        self._last[subject] = now
        return True


class LossyStream(io.TextIOBase):
    """A text stream that loses what cannot be written: no request fails because the log's disk is full."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError):
            self._stream.flush()


def configure_logging(level: str = "info") -> None:
    """Send every log line, ours and the libraries', to stderr as JSON; lines that cannot be written are lost."""
    import structlog

    stream = cast("TextIO", LossyStream(sys.stderr))
    shared: list[structlog.types.Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        # Without local variables: they may hold keys.
        structlog.processors.ExceptionRenderer(
            structlog.tracebacks.ExceptionDictTransformer(show_locals=False)
        ),
    ]
    structlog.configure(
        processors=[*shared, structlog.processors.JSONRenderer()],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.WriteLoggerFactory(file=stream),
        cache_logger_on_first_use=False,
    )
    handler = logging.StreamHandler(stream)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[
                structlog.stdlib.ProcessorFormatter.remove_processors_meta,
                structlog.processors.JSONRenderer(),
            ],
        )
    )
    root = logging.getLogger()
    root.handlers = [handler]
    root.setLevel(level.upper())
    logging.getLogger("alembic").setLevel(logging.WARNING)
    if level.lower() != "debug":  # SQLAlchemy's pools log as the modules of their classes, and ours are here
        logging.getLogger("app.records.database.lending").setLevel(logging.WARNING)
