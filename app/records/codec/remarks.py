"""What is said of a picture beside its figures, as JSON: remarks with their advice, and how well it was taken."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

from core.errors import Advisory
from core.targets.capture_quality import CaptureQuality


def encode_quality(quality: CaptureQuality | None) -> dict[str, Any] | None:
    """Return the value's own fields, with null for what is not finite, which JSON has no word for."""
    if quality is None:
        return None
    figures = {
        field.name: getattr(quality, field.name) for field in fields(quality) if field.name != "advice"
    }
    return {
        **{
            name: float(value) if value is not None and math.isfinite(value) else None
            for name, value in figures.items()
        },
        "advice": encode_advisories(quality.advice),
    }


def decode_quality(capture_quality: dict[str, Any]) -> CaptureQuality:
    """Return the capture quality of a stored result; angles in radians."""
    return CaptureQuality(**{**capture_quality, "advice": decode_advisories(capture_quality["advice"])})


def encode_advisories(advisories: tuple[Advisory, ...]) -> list[dict[str, Any]]:
    """Return remarks as the API shows them."""
    return [{"code": a.code, "detail": a.detail, "advice": a.advice} for a in advisories]


def decode_advisories(stored: list[dict[str, Any]]) -> tuple[Advisory, ...]:
    """Return the remarks of a stored result."""
    return tuple(Advisory(**one) for one in stored)
