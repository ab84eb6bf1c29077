"""A robot over its sessions, and two reports compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any
from urllib.parse import quote

from fastapi import Query, Request
from starlette.responses import RedirectResponse, Response

from app.analyses.history import (
    KINDS,
    MAX_CHARTS,
    ChartAxis,
    comparison_document,
    read_filed_report,
    read_history,
)
from app.errors import Conflict, InvalidContent
from app.web.pages import page_router, render
from app.web.service import service_of

router = page_router()
MAX_POINTS = 200
"""Sessions of one figure that a page lists, the latest; the CSV has all."""
TWO = 2
SIGMAS_BETWEEN_LIMITS = 6.0


@router.get("/robots/{robot_id}/history", operation_id="get_robot_history")
def show_history(
    request: Request,
    robot_id: str,
    kind: Annotated[str, Query(max_length=40)] = "",
    axis: ChartAxis = "date",
) -> Response:
    """Show a robot's figures with their control charts, what changed lastingly, and what was done to the robot."""
    chosen = next((one for one in KINDS if one == kind), None)
    if kind and chosen is None:
        raise InvalidContent(
            f"There is no kind of figures “{kind}”.", f"Choose one of {', '.join(KINDS)}, or none for all."
        )
    found = read_history(service_of(request).installation.database, robot_id, chosen)
    document = found.document()
    charted = sum(len(test.charts) for test in found.tests)
    return render(
        request,
        "robots/robot_history.html",
        history=document,
        tests=tests_of(document),
        alarms=[one["alarm"]["sentence"] for one in document["series"] if one["alarm"] is not None],
        kind=chosen,
        axis=axis,
        kinds=KINDS,
        charted=charted,
        most=MAX_CHARTS,
    )


@router.get("/reports/comparison", operation_id="get_report_comparison")
def show_comparison(
    request: Request,
    report: Annotated[list[str] | None, Query(max_length=20)] = None,
    of: Annotated[str, Query(max_length=64)] = "",
) -> Response:
    """Show two reports compared figure by figure, with a conclusion in words; where not two are ticked, the list that
    they were chosen in again, which is that of a session or of all.
    """
    chosen = list(dict.fromkeys(report or []))
    if len(chosen) != TWO:
        listed = f"/ui/sessions/{quote(of, safe='')}/reports" if of else "/ui/reports"
        return RedirectResponse(f"{listed}?ticked={len(chosen)}", status_code=303)
    found: dict[str, Any] | None = None
    refused: Conflict | None = None
    with service_of(request).installation.database.read() as records:
        try:
            first, second = (read_filed_report(records, one) for one in chosen)
            found = comparison_document(first, second)
        except Conflict as error:
            refused = error
    return render(request, "reports/report_comparison.html", found=found, refused=refused)


def tests_of(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return each test of a history with its figures, and of its sessions the latest ones with their values."""
    tests = []
    for test in document["tests"]:
        number = test["test"]
        figures = [one for one in document["series"] if one["test"] == number]
        names = [(one["of"], one["figure"]) for one in figures]
        sessions: dict[str, dict[str, Any]] = {}
        for point in document["session_figures"]:
            if point["test"] == number:
                owner = point["report_id"] or point["qualification_id"]
                row = sessions.setdefault(owner, {**point, "values": {}})
                row["values"][(point["of"], point["figure"])] = point
        rows = sorted(
            sessions.values(),
            key=lambda row: (row["measured_at"], row["report_id"] or row["qualification_id"]),
            reverse=True,
        )
        figures = [{**one, "interval": supported(one, document["session_figures"])} for one in figures]
        tests.append({**test, "figures": figures, "names": names, "rows": rows[:MAX_POINTS]})
    return tests


def supported(series: Mapping[str, Any], points: Sequence[Mapping[str, Any]]) -> list[float] | None:
    """Return the interval whose width says how many digits a series' figures support: that of its last point, else one
    of two standard deviations from the sessions' scatter, by its limits; None where neither is known.
    """
    name = ("test", "of", "figure")
    own = [one for one in points if all(one[key] == series[key] for key in name)]
    if own and own[-1]["low"] is not None and own[-1]["high"] is not None:
        return [own[-1]["low"], own[-1]["high"]]
    limits = series["limits"]
    if limits is None:
        return None
    reach = 2.0 * (limits["high"] - limits["low"]) / SIGMAS_BETWEEN_LIMITS
    return [limits["centre"] - reach, limits["centre"] + reach]
