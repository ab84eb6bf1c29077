"""The latest figures of every robot, for monitoring: from its latest report on repeatability."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from app.analyses.history.summaries import NotAReport, read_report
from app.errors import ServiceError
from app.records.database import Database
from app.services import reports, robots

MAX_ROBOTS = 100
"""Robots that monitoring shows: those whose reports are the latest. Each is a label, of which monitoring bears few."""


@dataclass(frozen=True, slots=True)
class RobotFigures:
    """Worst figures over the poses of a robot's latest report, mm; None where it has none."""

    robot_id: str
    name: str
    repeatability_worst_mm: float | None
    accuracy_worst_mm: float | None
    noise_floor_worst_mm: float | None
    measured_timestamp_seconds: float


class LatestFigures:
    """Reads each report once: reports never change."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._read: dict[str, RobotFigures | None] = {}

    def read(self) -> tuple[list[RobotFigures], int]:
        """Return the figures of `MAX_ROBOTS` robots at most, and how many more there are. Raises ServiceError."""
        with self._database.read() as records:
            latest = robots.latest_reports(records, 10 * MAX_ROBOTS)
        shown = list(latest.items())[:MAX_ROBOTS]
        kept = {
            report_id: self._read[report_id]
            if report_id in self._read
            else self._of(robot_id, report_id, name)
            for robot_id, (report_id, name) in shown
        }
        self._read = kept
        return [one for one in kept.values() if one is not None], len(latest) - len(shown)

    def _of(self, robot_id: str, report_id: str, name: str) -> RobotFigures | None:
        try:
            with self._database.read() as records:
                content, _ = reports.read_form(records, report_id, "json")
            found = read_report(content)
        except (ServiceError, NotAReport):
            return None
        worst: dict[str, float] = {}
        for (_, figure), one in found.figures.items():
            worst[figure] = max(worst.get(figure, one.value), one.value)
        at = datetime.fromisoformat(found.measured_at).timestamp()
        return RobotFigures(
            robot_id, name, worst.get("RP_l"), worst.get("AP_p"), worst.get("noise floor"), at
        )
