"""Which form of an answer an Accept header prefers."""

from __future__ import annotations

import pytest

from app.api.representations.preferences import prefers_csv


@pytest.mark.parametrize(
    ("accept", "csv"),
    [
        (None, False),
        ("*/*", False),
        ("text/csv", True),
        ("text/csv, application/json;q=0.9", True),
        ("text/csv;q=0.5, application/json", False),
        # As generated clients send it, which read JSON.
        ("application/json, text/csv, application/problem+json", False),
        ("text/csv;q=0", False),
    ],
)
def test_csv_is_for_those_who_prefer_it(accept: str | None, csv: bool) -> None:
    assert prefers_csv(accept) == csv
