"""What a request may end with in place of an answer."""

from __future__ import annotations

from collections.abc import Sequence


class ClientError(Exception):
    """The service refused a request, or could not be reached. Code, detail and advice are the service's own."""

    def __init__(
        self,
        code: str,
        detail: str,
        advice: str | None = None,
        status: int | None = None,
        fields: Sequence[tuple[str, str]] = (),
    ) -> None:
        self.summary = detail
        """`detail` without `fields`."""
        self.fields = tuple(fields)
        """Field and message of each invalid field of a refused body."""
        listed = "; ".join(f"{field}: {message}" for field, message in fields if message != detail)
        self.detail = f"{detail} {listed}" if listed else detail
        super().__init__(f"{self.detail} ({code})" if code else self.detail)
        self.code = code
        self.advice = advice
        self.status = status
        self.retry_after_s: float | None = None
        """The pause that the service asks for, in seconds."""


class ArgumentRefused(ClientError):
    """An address, a key or a target's form cannot be used; no request was made."""
