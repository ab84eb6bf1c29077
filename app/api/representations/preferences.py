"""What an Accept header prefers (RFC 9110, 12.5.1)."""

from __future__ import annotations

CSV = "text/csv"


def qualities(accept: str | None) -> dict[str, float]:
    """Return the weight of each media type that an Accept header names."""
    found: dict[str, float] = {}
    for part in (accept or "").split(","):
        name, *parameters = (piece.strip().lower() for piece in part.split(";"))
        quality = next((p[2:] for p in parameters if p.startswith("q=")), "1")
        try:
            found[name] = float(quality)
        except ValueError:
            found[name] = 0.0
    return found


def prefers_csv(accept: str | None) -> bool:
    """Return whether an Accept header names CSV, and JSON lower or not: generated clients name both and read JSON."""
    found = qualities(accept)
    return found.get(CSV, 0.0) > found.get("application/json", 0.0)
