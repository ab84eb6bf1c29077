"""Sends what is due: to every webhook its deliveries one after another, to several webhooks at a time."""

from __future__ import annotations

import asyncio
import time
from datetime import UTC, datetime

from app.delivery.posting import Attempt, post
from app.logs import Logger
from app.services.installation.context import ServiceContext
from app.services.notices import Claimed, claim_due, save_attempt, secret_of

log = Logger(__name__)


class Sender:
    """Claims, sends, and stores what came of it. Of several services on one database, each claims its own."""

    def __init__(self, installation: ServiceContext) -> None:
        self._database = installation.database
        self._pepper = installation.pepper

    def send_due(self) -> bool:
        """Send the oldest due delivery of each webhook; return whether there was any."""
        with self._database.write() as records:
            claimed = claim_due(records, datetime.now(UTC))
        if not claimed:
            return False
        attempts = asyncio.run(self._send(claimed))
        for one, attempt in zip(claimed, attempts, strict=True):
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
        return True

    async def _send(self, claimed: list[Claimed]) -> list[Attempt]:
        at_s = int(time.time())
        return await asyncio.gather(
            *(
                post(
                    one.url,
                    secret_of(self._pepper, one.webhook_id),
                    one.delivery_id,
                    one.document,
                    at_s=at_s,
                )
                for one in claimed
            )
        )
