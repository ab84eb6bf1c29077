"""One job in a worker process: load the original, run the numerics, encode what came of it."""

from __future__ import annotations

import json
import time
from typing import Any

from app.blobs.integrity import read_original
from app.build import core_version
from app.errors import OriginalCorrupt, OriginalMissing
from app.jobs.job import Job
from app.records.codec import encode_calibration, encode_refused
from app.records.numbers import rounded
from app.records.outcome import DetectedTarget, Failure, Outcome, Provenance
from core import Camera, GridposeError, Lens, TargetOutcome, TargetSpec, calibrate_targets
from core.errors import NotConverged, TargetAmbiguous, TargetMirrored, TargetMismatch, TargetNotFound

NAMED = 8
"""Targets listed in the text of a failure; a session may have many more."""
_SPECIFIC = (TargetAmbiguous, TargetMirrored, TargetMismatch, TargetNotFound)
"""Reasons why a target was not found, the most specific one first."""
_CORRECTION = (
    "If the session states the wrong target, change its target_ids (`gridpose sessions change`): its images are "
    "searched again."
)
_OF_WRONG_TARGETS = frozenset({TargetAmbiguous.code, TargetMismatch.code, TargetNotFound.code})
"""Failures that a wrong description of the target causes, too."""


def process_image(job: Job, path: str, max_pixels: int) -> tuple[Outcome, float]:
    """Measure one image and return what came of it and how many milliseconds that took.

    Only the bytes that were uploaded are measured: those read are hashed before they are decoded (0.5 ms per MB).
    What the numerics refuse is an outcome; anything else they raise is a defect and propagates.
    """
    started = time.perf_counter()
    try:
        data = read_original(path, job.sha256)
    except (OriginalMissing, OriginalCorrupt) as error:
        failure = Failure(error.code, error.detail, error.advice)
        return Outcome(None, failure), (time.perf_counter() - started) * 1000.0
    if job.has_explicit_target:
        outcome = measure_target(data, job, max_pixels)
    else:
        outcome = measure_all_targets(data, job, max_pixels)
    return outcome, (time.perf_counter() - started) * 1000.0


def process_for_storage(job: Job, path: str, max_pixels: int) -> tuple[Outcome, float]:
    """Return what `process_image` does, its documents as JSON text: whoever saves them has that to do no more."""
    outcome, duration_ms = process_image(job, path, max_pixels)
    return outcome.encoded(), duration_ms


def measure_target(data: bytes, job: Job, max_pixels: int) -> Outcome:
    """Calibrate the image `data` from the one target that `job` names."""
    (sought,) = job.targets
    provenance = _provenance(job, {"target": sought.fields}, max_pixels)
    try:
        (outcome,) = calibrate_targets(
            data, [TargetSpec(**sought.fields)], **_known(job), max_pixels=max_pixels
        )
    except GridposeError as error:
        return Outcome(*_refused(error, provenance))
    return Outcome(*_encoded(outcome, provenance))


def measure_all_targets(data: bytes, job: Job, max_pixels: int) -> Outcome:
    """Calibrate the image `data` from every target of `job` that it shows.

    The outcome's own result and failure say why the row's own target is not among those shown: of a row without one,
    why none of all is.
    """
    shown: list[DetectedTarget] = []
    missed: dict[str, GridposeError] = {}
    nothing = encode_refused(
        None, _provenance(job, {"targets": [sought.fields for sought in job.targets]}, max_pixels)
    )
    try:
        outcomes = calibrate_targets(
            data,
            [TargetSpec(**sought.fields) for sought in job.targets],
            **_known(job),
            max_pixels=max_pixels,
        )
    except GridposeError as error:
        return Outcome(nothing, _failure(error))
    started = time.perf_counter()
    for sought, outcome in zip(job.targets, outcomes, strict=True):
        provenance = _provenance(job, {"target": sought.fields}, max_pixels)
        if outcome.failure is not None and outcome.failure.points is None:
            missed[sought.target_id] = outcome.failure
            continue
        result, failure = _encoded(outcome, provenance)
        ended = time.perf_counter()
        shown.append(DetectedTarget(sought.target_id, result, failure, (ended - started) * 1000.0))
        started = ended
    return Outcome(nothing, _why_not(job, missed), tuple(shown))


def _why_not(job: Job, missed: dict[str, GridposeError]) -> Failure:
    """Return why the row's own target is not shown; of a row without one, why none is."""
    if job.target_id in missed:
        return _failure(missed[job.target_id])
    specific = [kind for kind in _SPECIFIC if any(type(failure) is kind for failure in missed.values())]
    reasons = [f for f in missed.values() if not specific or type(f) is specific[0]]
    listed = "; ".join(
        f"{sought.fields['kind']} {sought.fields['columns']} x {sought.fields['rows']} ({sought.target_id})"
        for sought in job.targets[:NAMED]
    )
    more = f"; and {len(job.targets) - NAMED} more" if len(job.targets) > NAMED else ""
    kind = specific[0] if specific else TargetNotFound
    found = f"None of the session's {len(job.targets)} targets was found."
    if reasons and kind is not TargetNotFound:
        found = reasons[0].detail
    return Failure(kind.code, f"{found} Looked for: {listed}{more}.", _advice(kind.code, kind.default_advice))


def _provenance(job: Job, sought: dict[str, Any], max_pixels: int) -> Provenance:
    return Provenance(
        core_version=core_version(),
        input_sha256=job.sha256,
        settings={
            **sought,
            "lens": job.lens,
            "intrinsics": job.intrinsics,
            "max_image_pixels": max_pixels,
        },
    )


def _known(job: Job) -> dict[str, Any]:
    """Return what the session states of its camera, as the numerics take it."""
    return {
        "lens": Lens(**job.lens) if job.lens is not None else None,
        "intrinsics": Camera(**job.intrinsics) if job.intrinsics is not None else None,
    }


def _encoded(outcome: TargetOutcome, provenance: Provenance) -> tuple[dict[str, Any], Failure | None]:
    if outcome.calibration is None:
        assert outcome.failure is not None
        return _refused(outcome.failure, provenance)
    columns = encode_calibration(outcome.calibration, provenance)
    if not _is_finite(columns["calibration"]):
        points = outcome.calibration.points
        return _refused(NotConverged("The estimate is not finite.", points=points), provenance)
    # Once, since lists of measurements are read often; analyses take the points, which keep every bit.
    return {**columns, "calibration": rounded(columns["calibration"])}, None


def _refused(error: GridposeError, provenance: Provenance) -> tuple[dict[str, Any], Failure]:
    return encode_refused(error.points, provenance), _failure(error)


def _failure(error: GridposeError) -> Failure:
    return Failure(error.code, error.detail, _advice(error.code, error.advice))


def _advice(code: str, advice: str | None) -> str | None:
    """Return the advice of the numerics and, where the session may be wrong, how it is corrected."""
    return f"{advice} {_CORRECTION}" if advice is not None and code in _OF_WRONG_TARGETS else advice


def _is_finite(document: dict[str, Any]) -> bool:
    """Return whether a document is free of NaN and infinity, which JSON lacks."""
    try:
        json.dumps(document, allow_nan=False)
    except ValueError:
        return False
    return True
