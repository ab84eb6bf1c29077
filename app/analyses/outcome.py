"""The outcome of an analysis, a document or a refusal, as plain values that pass between processes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class AnalysisRefused:
    """The reason why an analysis gave no document."""

    code: str
    detail: str
    advice: str | None


@dataclass(frozen=True, slots=True)
class AnalysisResult:
    """A document or a refusal, the hash of what it is made of (`Snapshot.answer_sha256`), and the session's change
    token (`inputs.change_token`) when they were read.
    """

    answer_sha256: str
    outcome: bytes | AnalysisRefused
    change_token: str


class AnalysisError(Exception):
    """The measurements do not determine what was requested."""

    def __init__(self, code: str, detail: str, advice: str | None) -> None:
        super().__init__(detail)
        self.refused = AnalysisRefused(code, detail, advice)
