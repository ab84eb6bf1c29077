"""Pauses after failures that grow with their number, so that what fails is tried again without a storm of attempts."""

from __future__ import annotations

import time

_FIRST_S = 0.1
_LONGEST_S = 5.0


class BackOff:
    """Counts failures in a row; `due` again after a pause that doubles with each of them."""

    def __init__(self, *, calm_failures: int = 0) -> None:
        self.failures = 0
        self._calm_failures = calm_failures
        self._not_before = 0.0

    @property
    def due(self) -> bool:
        """Whether the pause after the last failure is over."""
        return time.monotonic() >= self._not_before

    def failed(self) -> None:
        """Count a failure; the first `calm_failures` of a row cause no pause."""
        self.failures += 1
        counted = min(self.failures - self._calm_failures, 10)
        if counted > 0:
            self._not_before = time.monotonic() + min(_FIRST_S * 2.0**counted, _LONGEST_S)

    def pause(self, seconds: float) -> None:
        """Be due after so long; no failure is counted."""
        self._not_before = time.monotonic() + seconds

    def succeeded(self) -> None:
        """Forget the failures."""
        self.failures = 0
        self._not_before = 0.0
