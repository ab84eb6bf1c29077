"""Jobs of workers that are gone, and rows that no job is left for: both are handed out again."""

from __future__ import annotations

from contextlib import suppress

import procrastinate
import sqlalchemy as sa
from procrastinate import exceptions, jobs

from app.logs import Logger
from app.records.database import Database
from app.records.tables import Measurement

log = Logger(__name__)

SILENT_S = 8.0
"""After so long without a report a worker counts as gone, and its jobs are given to others."""


async def give_back_stalled(app: procrastinate.App) -> None:
    """Give the jobs of workers that have been silent too long to others."""
    for job in await app.job_manager.get_stalled_jobs(seconds_since_heartbeat=SILENT_S):
        try:
            await app.job_manager.retry_job(job)
        except exceptions.UniqueViolation:
            # Its row was queued again since, under a job of its own: this one is not needed any more.
            with suppress(exceptions.ConnectorException):  # another worker was quicker
                await app.job_manager.finish_job(job, status=jobs.Status.FAILED, delete_job=True)
        except exceptions.ConnectorException as error:
            log.info("stalled_job_not_given_back", job=job.task_kwargs, reason=repr(error))
        else:
            log.warning("stalled_job_given_back", job=job.task_kwargs)


_ORPHANED = sa.text(
    """
    SELECT id FROM measurements
    WHERE status IN ('queued', 'running')
        AND NOT EXISTS (
            SELECT FROM procrastinate_jobs WHERE queueing_lock = measurements.id AND status = 'todo'
        )
        AND id NOT IN (
            SELECT queueing_lock FROM procrastinate_jobs WHERE status = 'doing' AND queueing_lock IS NOT NULL
        )
    """
)


def recover_rows(database: Database) -> int:
    """Queue rows again that are to be computed and that no job names; return how many.

    Every program keeps rows and jobs together: this is for a queue whose tables were emptied by hand.
    """
    with database.read() as records:
        found = list(records.scalars(_ORPHANED))
    if not found:
        return 0
    with database.write() as records:
        # Asked again, with the rows locked: a worker may have taken or finished them since.
        records.execute(
            sa.select(Measurement.id)
            .where(Measurement.id.in_(found))
            .order_by(Measurement.id)
            .with_for_update()
        )
        orphaned = sorted(set(found) & set(records.scalars(_ORPHANED)))
        records.execute(
            sa.update(Measurement).where(Measurement.id.in_(orphaned)).values(status="queued", claim=None),
            execution_options={"synchronize_session": False},
        )
        records.execute(sa.text("SELECT queue_images(:wanted)"), {"wanted": orphaned})
    log.warning("rows_without_jobs_queued", rows=len(orphaned))
    return len(orphaned)
