"""When the runner goes through its next round, and when what failed is tried again.

A round costs a claim's and a save's transaction. Images that come one by one would each pay for both alone; of those
that come within `PACE_S`, one round takes all. After failures pauses grow with their number, so that what fails is
tried again without a storm of attempts.
"""

from __future__ import annotations

import math
import threading
import time

IDLE_POLL_S = 0.5
"""How often an idle runner looks by itself; jobs of the same process wake it at once."""
PACE_S = 0.04
"""How far the beginnings of rounds are apart, unless the workers run out of jobs while more are queued."""
GATHER_S = 0.04
"""How long a result may wait for others to be saved with it, while workers are busy or results come closely."""
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.1, 5.0


class Pace:
    """Lets one thread rest between its rounds; others may call it back."""

    def __init__(self) -> None:
        self._hurry = threading.Event()
        self._saved_s = -math.inf
        self._begun_s = -math.inf

    def hurry(self) -> None:
        """Let the next round begin at once; from any thread."""
        self._hurry.set()

    def rest(self) -> None:
        """Return when the next round may begin: at once where the one before began long ago."""
        rest_s = self._begun_s + PACE_S - time.monotonic()
        if rest_s > 0.0:
            self._hurry.wait(rest_s)
        self._hurry.clear()
        self._begun_s = time.monotonic()

    def saved(self) -> None:
        """Note that results were saved just now."""
        self._saved_s = time.monotonic()

    def gather_s(self, *, busy: bool) -> float:
        """Return how long a result may wait for others: not at all where the last ones were saved long ago."""
        recently = time.monotonic() - self._saved_s < GATHER_S
        return GATHER_S if busy or recently else 0.0


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
            self._not_before = time.monotonic() + min(_FIRST_PAUSE_S * 2.0**counted, _LONGEST_PAUSE_S)

    def pause(self, seconds: float) -> None:
        """Be due after so long; no failure is counted."""
        self._not_before = time.monotonic() + seconds

    def succeeded(self) -> None:
        """Forget the failures."""
        self.failures = 0
        self._not_before = 0.0
