"""The one table from errors to HTTP statuses, and the statuses' titles."""

from __future__ import annotations

from http import HTTPStatus

from app.errors import (
    Conflict,
    InvalidContent,
    NotAllowed,
    NotAuthenticated,
    NotFound,
    PreconditionFailed,
    QuotaExceeded,
    ServiceError,
    StorageFull,
    TooLarge,
    Unavailable,
    UnsupportedContent,
)

STATUSES: tuple[tuple[type[ServiceError], HTTPStatus], ...] = (
    (NotAuthenticated, HTTPStatus.UNAUTHORIZED),
    (NotAllowed, HTTPStatus.FORBIDDEN),
    (NotFound, HTTPStatus.NOT_FOUND),
    (Conflict, HTTPStatus.CONFLICT),
    (PreconditionFailed, HTTPStatus.PRECONDITION_FAILED),
    (TooLarge, HTTPStatus(413)),
    (UnsupportedContent, HTTPStatus.UNSUPPORTED_MEDIA_TYPE),
    (InvalidContent, HTTPStatus(422)),
    (QuotaExceeded, HTTPStatus.TOO_MANY_REQUESTS),
    (StorageFull, HTTPStatus.INSUFFICIENT_STORAGE),
    (Unavailable, HTTPStatus.SERVICE_UNAVAILABLE),
)
TITLES = {
    401: "Not authenticated",
    403: "Not allowed",
    404: "Not found",
    405: "Method not allowed",
    409: "Conflict",
    412: "Precondition failed",
    413: "Too large",
    415: "Unsupported media type",
    422: "Invalid content",
    429: "Too much",
    500: "Internal error",
    503: "Unavailable",
    507: "Storage full",
}


def status_of(error: ServiceError) -> HTTPStatus:
    """Return the status of a refusal of ours; 500 for one that the table does not know."""
    return next(
        (status for kind, status in STATUSES if isinstance(error, kind)), HTTPStatus.INTERNAL_SERVER_ERROR
    )
