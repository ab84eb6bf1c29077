"""The queue of images to measure: its interface, that on the measurement rows, and that of several machines."""

from app.jobs.job import Job, JobResult, TargetQuery
from app.jobs.queue.claimed_rows import is_target, read_jobs
from app.jobs.queue.interface import Queue
from app.jobs.queue.requeueing import TOGETHER, queue_rows, search_again
from app.jobs.queue.saving import ALREADY_MEASURED, measurements_of_image
from app.jobs.queue.sql_queue import SqlQueue
from app.records.database import Database


def queue_of(database: Database) -> Queue:
    """Return the queue of a database: one reader of the rows on SQLite, any number of them on PostgreSQL."""
    if database.is_sqlite:
        return SqlQueue(database)
    from app.jobs.queue.procrastinate_queue import ProcrastinateQueue  # an extra

    return ProcrastinateQueue(database)


__all__ = [
    "ALREADY_MEASURED",
    "TOGETHER",
    "Job",
    "JobResult",
    "Queue",
    "TargetQuery",
    "is_target",
    "measurements_of_image",
    "queue_of",
    "queue_rows",
    "read_jobs",
    "search_again",
]
