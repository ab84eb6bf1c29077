"""The interface between the code that accepts images and the code that measures them.

A job is a measurement row whose status is `queued`: whoever writes such a row has queued it. `SqlQueue` (`sql_queue`)
reads these rows; on PostgreSQL `ProcrastinateQueue` (`procrastinate_queue`) shares them among any number of workers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from app.jobs.job import Job, JobResult
from app.records.outcome import Failure


class Queue(Protocol):
    """Jobs in, claims out, results back; at least once each, and a result is written once."""

    def notify(self) -> None:
        """Say that jobs were committed, so that an idle runner looks at once."""
        ...

    def wait(self, timeout_s: float) -> None:
        """Return when somebody called `notify`, or after `timeout_s`."""
        ...

    def recover(self) -> int:
        """Give back the jobs a runner that is gone left running; attempts do not count. Needs the runner's lock."""
        ...

    def start_fetching(self, processes: int) -> None:
        """Begin to take jobs for so many worker processes; a queue that others share takes them beforehand."""
        ...

    def stop_fetching(self) -> None:
        """Take no more jobs, and leave to others what was taken and neither finished nor released."""
        ...

    def claim(self, limit: int) -> Sequence[Job]:
        """Take up to `limit` jobs: sessions take turns, and each one's jobs come oldest first.

        A row that cannot be read fails with a code instead, and is no job.
        """
        ...

    def finish(self, finished: Sequence[JobResult]) -> int:
        """Save results; those whose claim is no longer current are dropped. Return how many were saved."""
        ...

    def release(self, jobs: Sequence[Job]) -> None:
        """Put claimed jobs back untouched."""
        ...

    def attempt_failed(self, job: Job, failure: Failure, *, max_attempts: int) -> None:
        """Count an attempt that brought no result and queue the job again; after the last one it fails so."""
        ...
