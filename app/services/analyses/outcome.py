"""What an analysis comes to, a document or the reason why there is none: plain values that travel between processes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Analysed:
    """A document and what it was computed from; `mark` is the session's at that moment (`revision`)."""

    inputs_sha256: str
    pending: int
    body: bytes
    mark: str


@dataclass(frozen=True, slots=True)
class Refused:
    """Why there is no document."""

    code: str
    detail: str
    advice: str | None


class CannotAnalyse(Exception):
    """The measurements do not give what was asked for."""

    def __init__(self, code: str, detail: str, advice: str | None) -> None:
        super().__init__(detail)
        self.refused = Refused(code, detail, advice)
