"""One job in a worker process: load the original, run the numerics, encode what came of it."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from app.jobs.queue import Job
from app.records.codec import Failure, Outcome, Provenance, encode_calibration, encode_refused
from app.settings import program_version
from core import Camera, GridposeError, Lens, TargetSpec, calibrate_image
from core.errors import NotConverged


def process_image(job: Job, path: str, max_pixels: int) -> tuple[Outcome, float]:
    """Measure one image and return what came of it and how many milliseconds that took.

    What the numerics refuse is an outcome; anything else they raise is a defect and propagates.
    """
    started = time.perf_counter()
    outcome = measure(Path(path).read_bytes(), job, max_pixels)
    return outcome, (time.perf_counter() - started) * 1000.0


def measure(data: bytes, job: Job, max_pixels: int) -> Outcome:
    """Calibrate the image `data` as `job` says."""
    provenance = Provenance(
        core_version=program_version(),
        input_sha256=job.sha256,
        settings={
            "target": job.target,
            "lens": job.lens,
            "intrinsics": job.intrinsics,
            "max_image_pixels": max_pixels,
        },
    )
    try:
        calibration = calibrate_image(
            data,
            TargetSpec(**job.target),
            lens=Lens(**job.lens) if job.lens is not None else None,
            intrinsics=Camera(**job.intrinsics) if job.intrinsics is not None else None,
            max_pixels=max_pixels,
        )
        columns = encode_calibration(calibration, provenance)
        if not _is_finite(columns["calibration"]):
            raise NotConverged("The estimate is not finite.", points=calibration.points)
    except GridposeError as error:
        return Outcome(
            result=encode_refused(error.points, provenance),
            failure=Failure(error.code, error.detail, error.advice),
        )
    return Outcome(result=columns, failure=None)


def _is_finite(document: dict[str, Any]) -> bool:
    """Tell whether a document holds neither NaN nor infinity, which JSON has no word for."""
    try:
        json.dumps(document, allow_nan=False)
    except ValueError:
        return False
    return True
