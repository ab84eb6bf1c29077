"""What is asked of a process of the analyses, as plain values; the numerics are loaded there alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from app.analyses.computations import ServiceFailure
from app.errors import Conflict, NotFound, ServiceError, Unavailable
from app.reports.forms import CompanyTemplate

KINDS: dict[str, tuple[str, ...]] = {
    "repeatability": ("repeatability",),
    "kinematics": ("dh",),
    "camera": ("intrinsics",),
    "session": ("intrinsics", "repeatability"),
}
"""The analyses that a report of each kind holds. One of its own that is refused fails the report; a report on the whole
session names it with the reason."""
DH_DEFAULTS = {"estimator": "pooled", "method": "global", "model": "auto", "joint_tolerance_deg": "0.02"}
"""The settings that `GET .../dh` has by default."""
_OPTIONS: dict[str, dict[str, str]] = {
    "repeatability": {"estimator": "pooled"},
    "dh": DH_DEFAULTS,
    "joint_curves_plot": {name: value for name, value in DH_DEFAULTS.items() if name != "method"},
    "intrinsics": {"estimator": "pooled"},
}


@dataclass(frozen=True, slots=True)
class Drawing:
    """A drawing of a report by its name, with what draws it.

    `poses_a_page` is how many poses can be read on one page; None of a drawing that shows no poses, which is a plot.
    """

    name: str
    plot: str
    poses_a_page: int | None = None


DRAWINGS: dict[str, tuple[Drawing, ...]] = {
    "repeatability": (
        Drawing("scatter", "scatter_pages", 5),
        Drawing("drift", "drift_pages", 6),
        Drawing("steadiness", "steadiness_pages", 10),
    ),
    "kinematics": (Drawing("joint_curves", "joint_curves_plot"),),
    "camera": (Drawing("residuals", "residual_map"), Drawing("projection", "projection_map")),
    "session": (),
}
"""The drawings of each kind of report."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportOrder:
    """One report to make. `made_at` is when; `signing_key` the fingerprint of the key that will sign it."""

    report_id: str
    session_id: str
    kind: str
    title: str
    signatories: list[dict[str, str | None]]
    paper: str
    made_by: dict[str, str] | None
    made_at: datetime
    signing_key: str
    template: CompanyTemplate


@dataclass(frozen=True, slots=True, kw_only=True)
class VerificationOrder:
    """One report to verify: its originals, too, in this folder or the bucket of `blob_url`, if `with_originals`."""

    report_id: str
    with_originals: bool
    blob_url: str | None
    folder: str
    max_image_pixels: int


@dataclass(frozen=True, slots=True)
class MadeReport:
    """The forms of a report, and the build and the inputs that they are of."""

    forms: Mapping[str, bytes]
    core_version: str
    inputs_sha256: str


def settings_of(analysis: str, source: str) -> dict[str, str]:
    """Return the settings that reports compute an analysis with."""
    return {**_OPTIONS.get(analysis, {"estimator": "pooled"}), "source": source}


def compute_report(url: str, order: ReportOrder) -> MadeReport | ServiceFailure:
    """Make a report; runs in a process alongside the head."""
    from app.analyses.reporting.making import make_report
    from app.analyses.worker import open_database

    try:
        return make_report(open_database(url), order)
    except ServiceError as error:
        return _failure(error)


def compute_verification(url: str, order: VerificationOrder) -> dict[str, Any] | ServiceFailure:
    """Verify a report; runs in a process alongside the head."""
    from app.analyses.reporting.verification import verify_report
    from app.analyses.worker import open_database

    try:
        return verify_report(open_database(url), order)
    except ServiceError as error:
        return _failure(error)


def _failure(error: ServiceError) -> ServiceFailure:
    kind = next((kind for kind in (NotFound, Conflict) if isinstance(error, kind)), Unavailable)
    return ServiceFailure(kind, error.code, error.detail, error.advice)
