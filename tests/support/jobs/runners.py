"""Runners over an application's own queue, images for them, and the same without processes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from app.jobs.process_image import process_image
from app.jobs.queue import JobResult
from app.jobs.runner import JobRunner
from app.records.ids import new_id
from app.records.presence import RunnerLock
from tests.support.jobs.computations import compute_by_name, start_without_warm_up
from tests.support.service.originals import original_path
from tests.support.service.service import Api


@contextmanager
def runner_of(api: Api, queue: Any = None, **options: Any) -> Iterator[JobRunner]:
    """A runner with one worker process on the application's queue, or on `queue`.

    Its workers calibrate no image before they are ready unless they compute what the product computes or `initialise`
    says otherwise.
    """
    installation = api.installation
    values: dict[str, Any] = {"workers": 1, "timeout_s": 60.0, "compute": compute_by_name, **options}
    if values["compute"] is compute_by_name:
        values.setdefault("initialise", start_without_warm_up)
    runner = JobRunner(
        queue or installation.queue,
        installation.blobs,
        RunnerLock(installation.settings.data_dir, installation.database),
        max_pixels=1_000_000,
        **values,
    )
    runner.start()
    try:
        yield runner
    finally:
        runner.stop()


def queue_images(api: Api, image: bytes, orders: str) -> list[str]:
    """Send one image per order to a session of their own; return their measurements."""
    session_id = api.make_session()
    found = []
    for order in orders:
        response = api.put_image(session_id, image + new_id("img").encode() + order.encode())
        assert response.status_code == 202, response.text
        found.append(response.json()["id"])
    return found


def compute(api: Api) -> list[JobResult]:
    """Do what the runner and its worker do, in this process; return what was finished."""
    queue = api.installation.queue
    finished = [
        JobResult(job, *process_image(job, str(original_path(api.installation, job.sha256)), 10**7))
        for job in queue.claim(10)
    ]
    queue.finish(finished)
    return finished
