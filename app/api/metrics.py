"""Metrics for Prometheus."""

from __future__ import annotations

from collections.abc import Iterable

from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from app.analyses.history import LatestFigures
from app.analyses.service import AnalysisService
from app.build import core_version
from app.errors import ServiceError
from app.jobs.runner import JobRunner
from app.services import notices
from app.services.installation.context import ServiceContext
from app.services.sessions import Counts, count_all_measurements

_METHODS = {"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"}

_OF_ROBOTS = {
    "repeatability_worst_mm": "Largest RP_l of the poses in the robot's latest report on repeatability.",
    "accuracy_worst_mm": "Largest AP_p of the poses in that report, where there is one.",
    "noise_floor_worst_mm": "Largest noise floor of the poses in that report.",
    "measured_timestamp_seconds": "When the session of that report was measured, Unix time.",
}


class Metrics:
    """One application's numbers, in a registry of its own."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        labels = ("method", "route", "status")
        self._requests = Counter(
            "gridpose_http_requests", "Requests answered.", labels, registry=self.registry
        )
        self._durations = Histogram(
            "gridpose_http_request_duration_seconds",
            "Time from a request's first byte to its answer's last.",
            ("method", "route"),
            registry=self.registry,
            buckets=(0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10),
        )
        self._of_kind: dict[tuple[str, str, int], tuple[Counter, Histogram]] = {}
        """What was looked up once by method, route and status, which are few."""

    def request_done(self, method: str, route: str, status: int, duration_s: float) -> None:
        """Count one request; the route's pattern, never the address itself, so that labels stay few."""
        method = method if method in _METHODS else "OTHER"
        found = self._of_kind.get((method, route, status))
        if found is None:
            found = self._of_kind[method, route, status] = (
                self._requests.labels(method, route, str(status)),
                self._durations.labels(method, route),
            )
        found[0].inc()
        found[1].observe(duration_s)

    def watch(
        self, installation: ServiceContext, runner: JobRunner | None, analyses: AnalysisService
    ) -> None:
        """Report the queue, the runner, the analyses and the disk as well, looked up when asked."""
        self.registry.register(_Gauges(installation, runner, analyses))

    def render(self) -> bytes:
        """Return everything in Prometheus' text format."""
        return generate_latest(self.registry)


class _Gauges(Collector):
    def __init__(
        self, installation: ServiceContext, runner: JobRunner | None, analyses: AnalysisService
    ) -> None:
        self._installation = installation
        self._runner = runner
        self._analyses = analyses
        self._latest = LatestFigures(installation.database)

    def describe(self) -> Iterable[Metric]:
        return ()

    def collect(self) -> Iterable[Metric]:
        info = GaugeMetricFamily("gridpose_build_info", "The running version.", labels=["version"])
        info.add_metric([core_version()], 1)
        yield info
        try:
            with self._installation.database.read() as records:
                counts: Counts | None = count_all_measurements(records)
        except ServiceError:
            counts = None
        if counts is not None:
            by_status = GaugeMetricFamily(
                "gridpose_measurements",
                "Measurements by status; failed ones that were measured already are apart.",
                labels=["status"],
            )
            for status, count in counts.items():
                by_status.add_metric([status], count)
            yield by_status
        yield GaugeMetricFamily(
            "gridpose_disk_free_bytes",
            "Free space where originals lie.",
            value=self._installation.blobs.free_bytes(),
        )
        waiting, running = self._analyses.counts()
        analyses = GaugeMetricFamily(
            "gridpose_analyses", "Analyses that wait for a process or are computed.", labels=["state"]
        )
        analyses.add_metric(["waiting"], waiting)
        analyses.add_metric(["running"], running)
        yield analyses
        yield from self._of_webhooks()
        yield from self._of_robots()
        if self._runner is not None:
            yield GaugeMetricFamily(
                "gridpose_runner_up", "1 while jobs can be run.", value=int(self._runner.state.able)
            )
            yield GaugeMetricFamily(
                "gridpose_workers_ready",
                "Worker processes that would compute an image at once.",
                value=self._runner.state.ready,
            )
            yield CounterMetricFamily(
                "gridpose_jobs_finished", "Jobs run to their end.", value=self._runner.settlement.finished
            )
            yield CounterMetricFamily(
                "gridpose_worker_crashes", "Worker processes lost.", value=self._runner.settlement.crashes
            )
            yield CounterMetricFamily(
                "gridpose_job_timeouts", "Jobs ended by time-out.", value=self._runner.settlement.timeouts
            )

    def _of_webhooks(self) -> Iterable[Metric]:
        try:
            with self._installation.database.read() as records:
                counts = notices.counts_by_status(records)
        except ServiceError:
            return
        family = GaugeMetricFamily(
            "gridpose_webhook_deliveries", "Deliveries in the journals of webhooks.", labels=["status"]
        )
        for status, count in counts.items():
            family.add_metric([status], count)
        yield family

    def _of_robots(self) -> Iterable[Metric]:
        try:
            robots, hidden = self._latest.read()
        except ServiceError:
            return
        for name, text in _OF_ROBOTS.items():
            family = GaugeMetricFamily(f"gridpose_robot_{name}", text, labels=["robot_id", "robot"])
            for one in robots:
                value = getattr(one, name)
                if value is not None:
                    family.add_metric([one.robot_id, one.name], value)
            yield family
        yield GaugeMetricFamily(
            "gridpose_robots_not_shown",
            "Robots with a report on repeatability beyond the 100 reported last, which have no figures here.",
            value=hidden,
        )
