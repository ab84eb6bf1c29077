"""The threads that bring notices out of the service."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import UTC, datetime

import sqlalchemy as sa

from app.delivery.alert_file import AlertFile
from app.delivery.derived import Derived, derived_of
from app.delivery.measured import MeasuredSessions
from app.delivery.posting import post
from app.logs import Logger
from app.records.readable import unreadable_columns
from app.records.tables import Notice
from app.services.installation.context import ServiceContext
from app.services.installation.loop import Loop
from app.services.notices import (
    MAX_WEBHOOKS,
    Claimed,
    claim_due,
    note,
    prune,
    save_attempt,
    secret_of,
    take_up,
    unexamined,
)

_EVERY_S = 2.0
_LOOK_EVERY_S = 15.0
"""Between two looks for sessions that are measured."""
_PRUNE_EVERY_S = 3600.0

log = Logger(__name__)


class Delivery:
    """Examines notices, sends them to webhooks, and writes them to the alert file, until stopped."""

    def __init__(self, installation: ServiceContext) -> None:
        self._database = installation.database
        self._measured = MeasuredSessions(installation.database)
        self._sender = Sender(installation, self.notify)
        self._looked_s = self._pruned_s = -_PRUNE_EVERY_S
        path = installation.settings.alert_file
        file = None
        if path is not None:
            file = AlertFile(installation.database, path, installation.settings.data_dir)
        self._sending = Loop("webhooks", self._sender.send_due, _EVERY_S)
        self._writing = None if file is None else Loop("alert_file", file.append, _EVERY_S)
        self._examining = Loop("notices", self.examine, _EVERY_S)

    @property
    def _loops(self) -> list[Loop]:
        return [one for one in (self._examining, self._sending, self._writing) if one is not None]

    def start(self) -> None:
        """Begin."""
        for loop in self._loops:
            loop.start()

    def notify(self) -> None:
        """Say that something is to be sent."""
        self._sending.wake()

    def begin_stop(self) -> None:
        """Begin nothing new."""
        for loop in self._loops:
            loop.begin_stop()

    def stop(self) -> None:
        """End; an attempt that is being made is waited for, 15 s at most."""
        self.begin_stop()
        for loop in self._loops:
            loop.stop()
        self._sender.stop()

    def examine(self) -> bool:
        """Number and queue the notices that are new, with what follows from them; return whether there were any."""
        now_s = time.monotonic()
        if now_s - self._looked_s >= _LOOK_EVERY_S:
            self._looked_s = now_s
            self._measured.look()
        if now_s - self._pruned_s >= _PRUNE_EVERY_S:
            self._pruned_s = now_s
            with self._database.write() as records:
                prune(records, datetime.now(UTC))
        with self._database.read() as records:
            rows = unexamined(records)
        for row in rows:
            self._take_up(row)
        if rows:
            self._sending.wake()
            if self._writing is not None:
                self._writing.wake()
        return bool(rows)

    def _take_up(self, row: Notice) -> None:
        derived = [] if unreadable_columns(row) else self._derived(row)
        try:
            with self._database.write() as records:
                if take_up(records, row.id):
                    for one in derived:
                        note(records, one.type, one.data, about=one.about)
        except sa.exc.IntegrityError:  # another service was as quick: the next look repeats it
            log.info("notice_put_off", notice_id=row.id)

    def _derived(self, row: Notice) -> list[Derived]:
        try:
            return derived_of(self._database, row)
        except Exception:
            # A defect: the notice itself goes on its way.
            log.exception("notice_not_examined", notice_id=row.id)
            return []


class Sender:
    """Sends what is due: to every webhook its deliveries one after another, each webhook in a thread of its own.

    None waits for another's receiver. Of several services on one database, each claims its own.
    """

    def __init__(self, installation: ServiceContext, on_sent: Callable[[], None]) -> None:
        self._database = installation.database
        self._pepper = installation.pepper
        self._on_sent = on_sent
        self._threads = ThreadPoolExecutor(MAX_WEBHOOKS, "webhook")
        self._sending: dict[str, Future[None]] = {}

    def send_due(self) -> None:
        """Begin to send the oldest due delivery of each webhook that is sent nothing at the moment."""
        for webhook_id, sending in list(self._sending.items()):
            if sending.done():
                del self._sending[webhook_id]
                sending.result()  # raises what kept the outcome from being saved: it is sent again
        with self._database.write() as records:
            claimed = claim_due(records, datetime.now(UTC), besides=self._sending)
        for one in claimed:
            sending = self._sending[one.webhook_id] = self._threads.submit(self._send, one)
            sending.add_done_callback(lambda _: self._on_sent())

    def stop(self) -> None:
        """End; attempts that are being made are waited for."""
        self._threads.shutdown(cancel_futures=True)

    def _send(self, one: Claimed) -> None:
        secret = secret_of(self._pepper, one.webhook_id)
        attempt = asyncio.run(post(one.url, secret, one.delivery_id, one.document, at_s=int(time.time())))
        with self._database.write() as records:
            save_attempt(records, one, response_status=attempt.response_status, failure=attempt.failure)
        if attempt.failure is not None:
            log.warning(
                "webhook_not_delivered",
                webhook_id=one.webhook_id,
                delivery_id=one.delivery_id,
                attempt=one.attempt,
                reason=attempt.failure,
            )
