"""One line on one image: whether the target was found, how sharp and tilted it is, and what to change; and one on the
next view.
"""

from __future__ import annotations

import threading

from ..http import ClientError, Json
from ..summary import is_measured
from .delivery import SessionRun
from .gate import concerns_all


def describe_result(name: str, measurement: Json) -> str:
    """Return the line for a finished measurement; `name` is the file's."""
    quality = measurement["capture_quality"]
    failure = measurement["failure"]
    place = f"{measurement['pose_id']}"
    if measurement["cycle"] is not None:
        place += f" cycle {measurement['cycle']}"
    if is_of_burst(measurement):
        place += f" image {measurement['burst']}"
    parts = [f"{name} ({place})"]
    if failure is None:
        parts.append("found")
    elif is_measured(measurement):
        parts.append("found; its pose comes from the session's camera")
    else:
        parts.append(f"NOT MEASURED, {failure['code']}: {failure['detail']}")
    calibration = measurement["calibration"]
    if calibration is not None:
        points = calibration["reprojection"]
        parts.append(f"{points['points']} points, rms {points['rms_px']:.2f} px")
    if quality is not None:
        if quality["edge_width_px"] is not None:
            parts.append(f"edges {quality['edge_width_px']:.1f} px")
        if quality["tilt_deg"] is not None:
            parts.append(f"tilt {quality['tilt_deg']:.0f}°")
        parts.append(f"fills {100.0 * quality['coverage_fraction']:.0f} %")
    if to_do := _advice(measurement):
        parts.append(f"-> {to_do}")
    return ", ".join(parts).replace(", ->", " ->")


BURST_ADVICE = (
    "No image states a burst index above 1. Take two images at each stop (P1/c1-b1.png, P1/c1-b2.png; {burst} in a "
    "pattern): they count as one cycle, and their scatter is the instrument's noise without a model of it."
)


def is_of_burst(measurement: Json) -> bool:
    """Return whether an image is the second or a later one of its stop."""
    return (measurement["burst"] or 1) > 1


def wants_bursts(measurement: Json) -> bool:
    """Return whether an image is the first of a second cycle: stops have one image each, unless one was of a burst."""
    return not is_of_burst(measurement) and (measurement["cycle"] or 0) > 1


class NextViewLine:
    """Asks the service for the most informative next view and prints it, once where it has not changed.

    An answer is a computation, which may take longer than many results: it is waited for in a thread of its own.

    Parameters
    ----------
    run
        The session that is watched.
    purpose
        What is to become certain, as `POST .../next-view` takes it.
    """

    def __init__(self, run: SessionRun, purpose: str) -> None:
        self._run, self._purpose = run, purpose
        self._said = ""
        self._wanted = threading.Event()
        self._asking = threading.Lock()

    def want(self) -> None:
        """Have it asked for, once for all results that come before the answer to an earlier question."""
        self._wanted.set()

    def is_pending(self) -> bool:
        """Return whether it is wanted or being asked for."""
        return self._wanted.is_set() or self._asking.locked()

    def work(self, ended: threading.Event) -> None:
        """Ask whenever it is wanted, until `ended` is set."""
        while not ended.is_set():
            if self._wanted.wait(0.2):
                with self._asking:
                    self._wanted.clear()
                    self._ask()

    def _ask(self) -> None:
        """Ask once. A session that cannot be planned from yet gives the service's advice; an outage waits for the next
        image.
        """
        report = self._run.report
        try:
            found = self._run.client.create(
                f"/v1/sessions/{self._run.session_id}/next-view", {"purpose": self._purpose, "count": 1}
            )
        except ClientError as error:
            if concerns_all(error):
                report.trouble("next view", "", f"the next view cannot be asked for: {error}")
                return
            line = error.advice or str(error)
        else:
            line = found["suggestions"][0]["instruction"]
        report.over("next view", "")
        if line != self._said:
            self._said = line
            report.say(f"next: {line}")


def _advice(measurement: Json) -> str:
    """Return what to change: of an image that gave nothing the failure's advice first, else that of its quality."""
    quality, failure = measurement["capture_quality"], measurement["failure"]
    warnings = [w["advice"] for w in (quality["warnings"] if quality is not None else []) if w["advice"]]
    refused = [failure["advice"]] if failure is not None and not is_measured(measurement) else []
    said = [text for text in (*refused, *warnings) if text]
    return " ".join(dict.fromkeys(said))
