"""Queued reports made one after another, in a thread of the process that serves.

What is computed runs in the bounded processes of the analyses, as work of the key that ordered it, so that it takes no
more of them than that key's own requests would.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from app.analyses.computations import ServiceFailure
from app.analyses.history import summarise_reports, summary_or_none
from app.analyses.reporting.orders import MadeReport, ReportOrder, compute_report
from app.analyses.service import AnalysisService
from app.errors import RowUnreadable
from app.jobs.call_queue import Call, QueueFull
from app.jobs.subprocess_executor import START_WITHIN_S, Cancelled, OutOfMemory, ProcessDied, TimedOut
from app.logs import Logger
from app.records.readable import unreadable_columns
from app.records.tables import Report
from app.reports.forms import CompanyTemplate, TemplateInvalid, read_template
from app.services import reports, robots
from app.services.installation.context import ServiceContext
from app.services.installation.loop import Loop

_LOOK_EVERY_S = 30.0
"""Between two looks at the queue where nobody said that there is something in it."""
_PAUSE_S = 1.0

log = Logger(__name__)


class ReportMaker:
    """Makes queued reports until stopped."""

    def __init__(self, installation: ServiceContext, analyses: AnalysisService) -> None:
        self._installation = installation
        self._analyses = analyses
        self._url = installation.database.url.render_as_string(hide_password=False)
        self._call: Call[MadeReport | ServiceFailure] | None = None
        self._loop = Loop("reports", self._step, _LOOK_EVERY_S)

    def start(self) -> None:
        """Queue again what the last process was making, and begin."""
        self._requeue()
        self._loop.start()

    def notify(self) -> None:
        """Say that a report was ordered."""
        self._loop.wake()

    def begin_stop(self) -> None:
        """Begin no further report, and give up the one being made: the next start makes it."""
        self._loop.begin_stop()
        call = self._call
        if call is not None:
            self._analyses.calls.cancel(call)

    def stop(self) -> None:
        """End; returns when no report is being made."""
        self.begin_stop()
        self._loop.stop()

    def _requeue(self) -> int:
        """Queue again what nobody is making any more, and return how many: what a process that ended was making, and
        what this one could neither store nor put back, as on a full disk.

        With SQLite this is the only service, and makes nothing when it asks; others may take longer.
        """
        before = None
        if not self._installation.database.is_sqlite:
            longest_s = self._installation.settings.analysis_timeout_s + START_WITHIN_S
            before = datetime.now(UTC) - timedelta(seconds=2.0 * longest_s)
        with self._installation.database.write() as records:
            again = reports.requeue_interrupted(records, before=before)
        if again:
            log.info("reports_queued_again", reports=again)
        return again

    def _step(self) -> bool:
        """Make a report, or look after the others; return whether there is more to do at once."""
        if self._make_next():
            return True
        again = self._requeue()
        # Of reports that were made before summaries were, or restored: some at a time.
        some = summarise_reports(self._installation.database)
        return again + some > 0

    def _make_next(self) -> bool:
        """Make the report that waits longest; return whether there was one, so that others may follow."""
        with self._installation.database.write() as records:
            row = reports.claim_next(records)
            if row is None:
                return False
            report_id, damaged = row.id, unreadable_columns(row)
            if damaged:
                error = RowUnreadable("report", damaged)
                reports.save_failure(records, report_id, error.code, error.detail, error.advice)
                return True
        try:
            self._make(row, row.attempts)
        except BaseException:
            self._put_back(report_id)
            raise
        return True

    def _make(self, row: Report, attempts: int) -> None:
        try:
            template = read_template(self._installation.settings.data_dir / "templates")
        except TemplateInvalid as error:
            self._fail(
                row.id,
                "template_invalid",
                f"The company's template cannot be used: {error}.",
                "Correct the file in the data folder's templates/, then order the report again; docs/reports.md "
                "describes it.",
            )
            return
        order = self._order(row, template)
        try:
            self._call = self._analyses.calls.submit(row.made_by, compute_report, self._url, order)
            if self._loop.is_stopping():
                self._analyses.calls.cancel(self._call)
            made = self._call.future.result()
        except QueueFull:
            self._put_back(row.id)
            self._loop.pause(_PAUSE_S)
            return
        except (OutOfMemory, TimedOut):
            self._fail(
                row.id,
                "report_too_large",
                "The report takes more time or memory than an analysis may have.",
                "Divide the images among sessions, or raise GRIDPOSE_ANALYSIS_TIMEOUT_S or "
                "GRIDPOSE_ANALYSIS_MEMORY_BYTES and order the report again.",
            )
            return
        except Cancelled:
            self._put_back(row.id)
            return
        except ProcessDied:
            self._retry_or_fail(row.id, attempts)
            return
        except Exception:
            # A defect: the log has its trace. The report fails rather than be tried again and again.
            log.exception("report_failed", report_id=row.id)
            self._fail(
                row.id,
                "report_failed",
                "The report could not be made for a reason that the service does not know.",
                "Order the report again; if it fails again, the server's log has the details under `report_failed`.",
            )
            return
        finally:
            self._call = None
        if isinstance(made, ServiceFailure):
            self._fail(row.id, made.code, made.detail, made.advice)
        else:
            self._save(order, made)

    def _order(self, row: Report, template: CompanyTemplate) -> ReportOrder:
        from app.reports.signature import fingerprint_of, signing_key  # with the first report

        maker = (
            None if row.made_by is None else {"key_id": row.made_by, "name": row.made_by_name or row.made_by}
        )
        return ReportOrder(
            report_id=row.id,
            session_id=row.session_id,
            kind=row.kind,
            title=row.title,
            signatories=row.signatories,
            paper=row.paper,
            made_by=maker,
            # Where the clock was set back, not before the report was ordered.
            made_at=max(datetime.now(UTC), row.created_at).replace(microsecond=0),
            signing_key=fingerprint_of(signing_key(self._installation.pepper)),
            template=template,
        )

    def _save(self, order: ReportOrder, made: MadeReport) -> None:
        from app.reports.signature import sign_report, signing_key

        manifest = reports.manifest_of(
            report_id=order.report_id,
            kind=order.kind,
            session_id=order.session_id,
            made_at=order.made_at,
            core_version=made.core_version,
            forms=made.forms,
        )
        with self._installation.database.write() as records:
            reports.save_report(
                records,
                order.report_id,
                forms=made.forms,
                signature=sign_report(signing_key(self._installation.pepper), manifest),
                core_version=made.core_version,
                inputs_sha256=made.inputs_sha256,
                finished_at=max(datetime.now(UTC), order.made_at),
            )
            robots.save_summaries(records, {order.report_id: summary_or_none(made.forms["json"])})
        log.info("report_made", report_id=order.report_id, kind=order.kind, forms=sorted(made.forms))

    def _retry_or_fail(self, report_id: str, attempts: int) -> None:
        log.warning("report_process_died", report_id=report_id, attempts=attempts)
        if attempts < reports.MAX_ATTEMPTS and not self._loop.is_stopping():
            with self._installation.database.write() as records:
                reports.put_back(records, report_id, counts=True)
            return
        if self._loop.is_stopping():
            self._put_back(report_id)
            return
        self._fail(
            report_id,
            "worker_crashed",
            f"The process that made the report died {attempts} times.",
            "The server may be short of memory: divide the images among sessions, then order the report again.",
        )

    def _put_back(self, report_id: str) -> None:
        with self._installation.database.write() as records:
            reports.put_back(records, report_id)

    def _fail(self, report_id: str, code: str, detail: str, advice: str | None) -> None:
        with self._installation.database.write() as records:
            reports.save_failure(records, report_id, code, detail, advice)
        log.info("report_refused", report_id=report_id, code=code)
