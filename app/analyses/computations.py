"""What analyses are computed by, each function in a process alongside the head, which alone loads the numerics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from app.analyses.outcome import AnalysisRefused, AnalysisResult
from app.errors import Conflict, NotFound, ServiceError, Unavailable

_KEPT_PLANS = 4
_plans: dict[str, dict[str, Any]] = {}
"""Plans of tests that this process computed last, by what was asked."""


@dataclass(frozen=True, slots=True)
class ServiceFailure:
    """A refusal of the service's own, which travels between processes as plain values."""

    kind: type[ServiceError]
    code: str
    detail: str
    advice: str | None


def compute(
    url: str, analysis: str, session_id: str, settings: Mapping[str, str]
) -> AnalysisResult | ServiceFailure:
    """Run in a process alongside the head, which alone loads the numerics for it."""
    from app.analyses.worker import analyse, open_database

    try:
        return analyse(open_database(url), analysis, session_id, settings)
    except ServiceError as error:
        kind = next((kind for kind in (NotFound, Conflict) if isinstance(error, kind)), Unavailable)
        return ServiceFailure(kind, error.code, error.detail, error.advice)


def compute_plan(
    robot: Mapping[str, Any], target: Mapping[str, Any], request: Mapping[str, Any]
) -> bytes | AnalysisRefused:
    """Run in a process alongside the head."""
    from app.analyses.documents.dh import plan_document
    from app.analyses.outcome import AnalysisError
    from app.records.numbers import encode
    from core import GridposeError

    try:
        return encode(plan_document(robot, target, request))
    except AnalysisError as reason:
        return reason.refused
    except GridposeError as error:
        return AnalysisRefused(error.code, error.detail, error.advice)


def compute_robot_file(
    document: Mapping[str, Any], robot: Mapping[str, Any] | None, session_name: str, name: str
) -> bytes:
    """Return the identified robot of an analysis `dh` as a file, empty where it cannot be one of this name; run in a
    process alongside the head.
    """
    from app.analyses.documents.robot_files import exports_of

    files = exports_of(dict(document), None if robot is None else dict(robot), session_name)
    return files.get(name, "").encode()


def compute_sheet(target: dict[str, Any], options: dict[str, Any]) -> bytes | AnalysisRefused:
    """Run in a process alongside the head."""
    from app.printing import draw_sheet, to_pdf, to_svg
    from core import GridposeError, TargetSpec

    refused: AnalysisRefused | None = None
    for paper in options["papers"]:
        try:
            sheet = draw_sheet(TargetSpec(**target), paper, name=options["name"])
            return to_pdf(sheet) if options["form"] == "pdf" else to_svg(sheet)
        except GridposeError as error:
            refused = refused or AnalysisRefused(error.code, error.detail, error.advice)
    assert refused is not None, "no paper was named"
    return refused


def compute_test_plan(
    target: Mapping[str, Any], asked: Mapping[str, Any], suffix: str
) -> bytes | AnalysisRefused:
    """Return the plan of a test by ISO 9283 as a file; run in a process alongside the head.

    The last plans are kept: a page and each of its files ask for the same one, which takes seconds.
    """
    from app.analyses.documents.iso9283 import PLAN_WRITERS, TestRequest, plan_test
    from core import GridposeError, TargetSpec

    question = repr((dict(target), dict(asked)))
    plan = _plans.get(question)
    if plan is None:
        try:
            plan = plan_test(TargetSpec(**target), TestRequest(**asked))
        except GridposeError as error:
            return AnalysisRefused(error.code, error.detail, error.advice)
        if len(_plans) == _KEPT_PLANS:
            del _plans[next(iter(_plans))]
        _plans[question] = plan
    return PLAN_WRITERS[suffix](plan)
