"""What the service refuses, as one tree; it knows nothing of HTTP statuses (`api/problems.py` has that table).

ServiceError                       code, detail, advice, errors [(field, message)]
├── NotAuthenticated               not_authenticated
├── NotAllowed                     insufficient_scope
├── NotFound                       <noun>_not_found
├── Conflict                       conflict, measurement_running, target_in_use, ...
├── InvalidContent                 invalid_request, hash_mismatch, target_unknown, ...
├── UnsupportedContent             unsupported_media_type, unsupported_image
├── TooLarge                       body_too_large, upload_too_large
├── StorageFull                    storage_full
└── Unavailable                    busy, not_ready
"""

from __future__ import annotations

from collections.abc import Sequence


class ServiceError(Exception):
    """Base of everything the service refuses on purpose."""

    code = "service_error"

    def __init__(
        self,
        detail: str,
        advice: str | None = None,
        *,
        code: str | None = None,
        errors: Sequence[tuple[str, str]] = (),
    ) -> None:
        super().__init__(detail)
        self.detail = detail
        self.advice = advice
        self.code = code if code is not None else type(self).code
        self.errors = tuple(errors)


class NotAuthenticated(ServiceError):
    code = "not_authenticated"


class NotAllowed(ServiceError):
    code = "insufficient_scope"


class NotFound(ServiceError):
    code = "not_found"

    @classmethod
    def of(cls, noun: str) -> NotFound:
        """Say that there is no such `noun`, without echoing what was asked for."""
        return cls(
            f"There is no such {noun}.", "Check the id; lists show what exists.", code=f"{noun}_not_found"
        )


class Conflict(ServiceError):
    code = "conflict"


class InvalidContent(ServiceError):
    code = "invalid_request"


class UnsupportedContent(ServiceError):
    code = "unsupported_media_type"


class TooLarge(ServiceError):
    code = "body_too_large"


class StorageFull(ServiceError):
    code = "storage_full"

    def __init__(self, detail: str = "There is no room to store this.") -> None:
        super().__init__(
            detail, "Free disk space on the server; nothing was kept of this request, so send it again."
        )


class Unavailable(ServiceError):
    code = "unavailable"
