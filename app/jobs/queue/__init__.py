"""The queue of images to measure: its interface, and the one on the measurement rows (`sql_queue`)."""

from app.jobs.queue.claimed_rows import is_target
from app.jobs.queue.interface import Job, JobResult, Queue, TargetQuery
from app.jobs.queue.requeueing import TOGETHER, queue_rows, search_again
from app.jobs.queue.saving import ALREADY_MEASURED
from app.jobs.queue.sql_queue import SqlQueue

__all__ = [
    "ALREADY_MEASURED",
    "TOGETHER",
    "Job",
    "JobResult",
    "Queue",
    "SqlQueue",
    "TargetQuery",
    "is_target",
    "queue_rows",
    "search_again",
]
