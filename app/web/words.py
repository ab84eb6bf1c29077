"""Figures and states in words: what a reader of a page sees in place of codes and floating-point numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from app.jobs.queue import ALREADY_MEASURED
from app.records.tables import Measurement
from app.reports.forms import VERDICTS as SAID_BY_VERDICTS
from app.reports.forms import words as named

NONE = "–"
_MINUS = "−"
MAX_MORE_DIGITS = 3


@dataclass(frozen=True, slots=True)
class State:
    """What came of an image: a class for its colour, a sign that needs no colour, a word, and a sentence."""

    kind: str
    sign: str
    word: str
    sentence: str


WAITING = State("wait", "○", "waiting", "The image is stored and waits for a worker.")
COMPUTING = State("wait", "◐", "computing", "A worker computes the image now.")
MEASURED = State("good", "✓", "measured", "The image by itself determines camera and pose.")
WEAK = State(
    "fair",
    "≈",
    "measured, weak",
    "The image by itself leaves its focal length uncertain by more than 2 %; pooled estimates use it in full.",
)
POINTS_ONLY = State(
    "fair",
    "!",
    "refused, points used",
    "The grid was found, but the image alone does not determine the answer; pooled estimates use its points.",
)
REFUSED = State("bad", "✕", "refused", "Nothing could be measured in the image.")
EXCLUDED = State("mute", "⊘", "excluded", "A user keeps the measurement out of analyses.")
DUPLICATE = State("mute", "=", "duplicate", "The image is measured at this pose already.")
UNREADABLE = State("bad", "✕", "unreadable", "The stored measurement cannot be read.")


def state_of(measurement: Measurement) -> State:
    """Return what came of an image."""
    if measurement.excluded is not None:
        return EXCLUDED
    if measurement.status == "queued":
        return WAITING
    if measurement.status == "running":
        return COMPUTING
    result = measurement.result
    if measurement.status == "succeeded":
        calibration = result.calibration if result is not None else None
        if not isinstance(calibration, dict):
            return UNREADABLE
        return WEAK if calibration.get("grade") == "weak" else MEASURED
    if measurement.failure_code == ALREADY_MEASURED.code:
        return DUPLICATE
    return POINTS_ONLY if result is not None and result.labelling is not None else REFUSED


def legend_of(measurements: Sequence[Measurement]) -> list[State]:
    """Return those states of the images that their word alone does not explain."""
    shown = {state_of(one) for one in measurements}
    return [state for state in (WEAK, POINTS_ONLY) if state in shown]


VERDICTS: dict[str, State] = {
    name: State(kind, sign, named(name), SAID_BY_VERDICTS[name])
    for name, kind, sign in (
        ("robot", "good", "✓"),
        ("instrument_limited", "fair", "≈"),
        ("not_steady", "bad", "↗"),
        ("below_detection", "fair", "<"),
        ("too_few_cycles", "fair", "?"),
    )
}
NO_CYCLES = State("mute", "○", "no figure", "Repeatability takes two cycles of a pose that are measured.")
DECISIONS: dict[str, State] = {
    "pass": State("good", "✓", "pass", "The whole interval is within the data sheet's value."),
    "fail": State("bad", "✕", "fail", "The whole interval is beyond the data sheet's value."),
    "inconclusive": State("fair", "?", "inconclusive", "The measurement does not decide."),
}
CHECK_STATES: dict[str, State] = {
    "ok": State("good", "✓", "well", "Nothing to do."),
    "warning": State("fair", "!", "look", "It works; see what to do."),
    "failed": State("bad", "✕", "not well", "Part of the work is not done until this is mended."),
}
REPORT_STATES: dict[str, State] = {
    "queued": State("wait", "○", "waiting", "The report is ordered and waits to be made."),
    "running": State("wait", "◐", "being made", "The report is being made now."),
    "succeeded": State("good", "✓", "made", "The report is stored and signed; nothing changes it."),
    "failed": State("bad", "✕", "not made", "The report could not be made."),
}
REPORT_KINDS: dict[str, str] = {
    "repeatability": "poses by ISO 9283",
    "kinematics": "identified Denavit-Hartenberg parameters",
    "camera": "intrinsics with uncertainties",
    "session": "all images, camera and repeatability in short",
}
REPORT_FORMS: dict[str, str] = {
    "pdf": "to be filed and signed",
    "html": "one page with its drawings",
    "csv": "a row for each figure",
    "json": "every figure and its inputs",
    "xml": "a digital calibration certificate (DCC)",
    "sig": "the detached signature",
}
ESTIMATORS: dict[str, tuple[str, str]] = {
    name: (named(name).capitalize(), text)
    for name, text in {
        "pooled": "One camera for all images of a focus group: the smallest noise. The default.",
        "pooled_free_focal": "One camera, but a focal length for each image: use it where the lens breathes or "
        "refocuses. More noise along the optical axis.",
        "per_image": "Every image has a camera of its own. The noise floor is much higher; it shows what one image "
        "determines.",
        "per_image_session_prior": "Every image by itself, with the lens of the session's other images as its prior.",
        "per_image_fixed_pp": "As before with the principal point held: less noise than each image alone.",
        "given": "The session's stated intrinsics, taken as they are.",
    }.items()
}
"""Names and explanations, in the order in which they are offered."""
METHODS: dict[str, str] = {
    "proposed_nullspace": "Boby and Saha, null space",
    "proposed_vanishing_point": "Boby and Saha, vanishing points",
    "zhang": "Zhang",
    "opencv_single_image": "OpenCV, single image",
    "tsai": "Tsai",
    "dlt": "DLT",
    "five_points": "Five points",
    "lines": "Lines",
    "aruco_marker": "ArUco, one marker",
    "aruco_board": "ArUco, whole board",
    "pooled": "Gridpose, pooled",
}
LENS_MODELS: dict[str, str] = {name: named(name) for name in ("brown", "rational", "kannala_brandt")}
VIEW_PURPOSES: dict[str, tuple[str, str]] = {
    "intrinsics": ("Camera", "the lens"),
    "hand_eye": ("Hand-eye", "where the camera sits on the flange"),
    "dh": ("Robot", "the chain's lengths and angles"),
}
SCOPES = {
    "read": "reads everything, changes nothing",
    "ingest": "sends images and commanded poses, reads nothing else",
    "upload": "reads, sends, creates and corrects",
    "admin": "everything, deletion and keys included",
}


def number(value: float | None, digits: int = 3) -> str:
    """Return so many significant digits, without "-0"; a dash for None."""
    if value is None:
        return NONE
    if not math.isfinite(value) or value == 0.0:
        return "0" if value == 0.0 else NONE
    rounded = float(f"{value:.{digits - 1}e}")
    decimals = digits - 1 - math.floor(math.log10(abs(rounded)))
    if decimals > 9 or decimals < -6:
        return f"{value:.{digits - 1}e}".replace("-", _MINUS)
    return signless_zero(f"{rounded:.{max(decimals, 0)}f}")


def plain(value: float | None) -> str:
    """Return a stated value as it was stated, without trailing zeros; a dash for None."""
    return NONE if value is None else signless_zero(f"{value:.10g}")


def fixed(value: float | None, decimals: int) -> str:
    """Return so many decimals, without "-0"; a dash for None."""
    return NONE if value is None or not math.isfinite(value) else signless_zero(f"{value:.{decimals}f}")


def signless_zero(text: str) -> str:
    """Return the text of a number with a true minus sign, and none before a zero."""
    if text.startswith("-"):
        return text[1:] if not text.strip("-0.") else _MINUS + text[1:]
    return text


def decimals_of(uncertainty: float | None) -> int | None:
    """Return the decimals that show two digits of an uncertainty; None without one."""
    if uncertainty is None or not math.isfinite(uncertainty) or uncertainty <= 0.0:
        return None
    return min(9, max(0, 1 - math.floor(math.log10(uncertainty))))


def with_uncertainty(value: float | None, uncertainty: float | None) -> str:
    """Return `value ± uncertainty`, both to two digits of the uncertainty."""
    decimals = decimals_of(uncertainty)
    if value is None or decimals is None or uncertainty is None:
        return number(value, 6)
    return f"{fixed(value, decimals)} ± {fixed(uncertainty, decimals)}"


def rounded_by(value: float | None, scatter: float | None, digits: int = 3) -> str:
    """Return a value to two digits of its scatter; to so many of its own where none is known."""
    decimals = decimals_of(scatter)
    return number(value, digits) if decimals is None else fixed(value, decimals)


def rounded_by_interval(value: float | None, bounds: Sequence[float] | None) -> str:
    """Return a value to the digits that its 95 % interval supports."""
    return number(value) if bounds is None else rounded_by(value, (bounds[1] - bounds[0]) / 4.0)


def shown_change(
    earlier: float, later: float, difference: float, bounds: Sequence[float], *, as_ratio: bool = False
) -> tuple[str, str, str]:
    """Return two values and their difference, to the digits that its 95 % interval supports, and so many more that what
    is shown of the values differs by what is shown of the difference; not where their ratio is shown in its place.
    """
    decimals = decimals_of((bounds[1] - bounds[0]) / 4.0)
    if decimals is None:
        return number(earlier), number(later), number(difference)
    for more in range(0 if as_ratio else MAX_MORE_DIGITS + 1):
        rounded = [round(value, decimals + more) for value in (earlier, later, difference)]
        if abs(rounded[1] - rounded[0] - rounded[2]) < 0.1 * 10.0 ** -(decimals + more):
            decimals += more
            break
    return fixed(earlier, decimals), fixed(later, decimals), fixed(difference, decimals)


def length_with_uncertainty(vector: Sequence[float], uncertainty: Sequence[float]) -> str:
    """Return a vector's length with its standard uncertainty, that along the vector; of none, the largest one's."""
    length = math.hypot(*vector)
    if length > 0.0:
        along = math.hypot(*(v * u for v, u in zip(vector, uncertainty, strict=True))) / length
    else:
        along = max(uncertainty)
    return with_uncertainty(length, along)


def interval(bounds: Sequence[float] | None, digits: int = 3) -> str:
    """Return `[low, high]`, both with as many decimals as the higher needs."""
    if bounds is None:
        return NONE
    low, high = bounds
    largest = max(abs(low), abs(high))
    decimals = 0 if largest == 0.0 else min(9, max(0, digits - 1 - math.floor(math.log10(largest))))
    return f"[{fixed(low, decimals)}, {fixed(high, decimals)}]"


def moment(value: datetime | None) -> str:
    """Return a time to the second, UTC; scripts restate it in the reader's own time zone."""
    return NONE if not isinstance(value, datetime) else value.strftime("%Y-%m-%d %H:%M:%S UTC")


def machine_moment(value: datetime | None) -> str:
    """Return a time for a `datetime` attribute."""
    return "" if not isinstance(value, datetime) else value.isoformat()


def size(count: int) -> str:
    """Return a number of bytes in its unit."""
    value, units = float(count), ["bytes", "kB", "MB", "GB", "TB"]
    while value >= 1000.0 and len(units) > 1:
        value /= 1000.0
        units.pop(0)
    return f"{count} bytes" if units[0] == "bytes" else f"{number(value)} {units[0]}"


def plural(count: int, noun: str) -> str:
    """Return `1 image`, `2 images`, `10 000 images`."""
    return f"{grouped(count)} {noun if count == 1 else noun + 's'}"


def grouped(count: int) -> str:
    """Return a whole number with narrow spaces between thousands."""
    return f"{count:,}".replace(",", "\u202f")


def words(code: str) -> str:
    """Return a code as words."""
    return code.replace("_", " ")
