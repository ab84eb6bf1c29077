"""Notices on their way out of the service: examined, sent to webhooks, written to the alert file.

Nothing here is on a request's path: what happens is written as a row in its own transaction, and threads take it from
there. A service that is killed in between goes on at its next start.
"""

from app.delivery.alert_file import AlertFile
from app.delivery.delivery import Delivery

__all__ = ["AlertFile", "Delivery"]
