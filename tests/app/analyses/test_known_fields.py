"""What a later version states in addition to a report's figures."""

from __future__ import annotations

from typing import Any

import pytest

from app.analyses.reporting.known_fields import known_fields

THEN = {
    "poses": [{"id": "P1", "rp": 0.1}, {"id": "P2", "rp": None, "note": "n"}],
    "floor": None,
    "warnings": [],
}


@pytest.mark.parametrize(
    ("now", "known"),
    [
        ({**THEN, "burst": {"n": 3}}, THEN),  # a field of a later version
        (
            {**THEN, "poses": [{"id": "P1", "rp": 0.1, "drift": 1}]},
            {**THEN, "poses": [{"id": "P1", "rp": 0.1}]},
        ),
        ({**THEN, "poses": [{"id": "P1", "note": "m"}]}, {**THEN, "poses": [{"id": "P1", "note": "m"}]}),
        # What came in the place of something that is known stays: it is a disagreement.
        ({**THEN, "floor": {"rp": 1}}, {**THEN, "floor": {"rp": 1}}),
        ({**THEN, "warnings": [{"code": "x"}]}, {**THEN, "warnings": [{"code": "x"}]}),
        (
            {**THEN, "poses": [*THEN["poses"], {"id": "P3"}]},
            {**THEN, "poses": [*THEN["poses"], {"id": "P3"}]},
        ),
        ({"floor": 2}, {"floor": 2}),
    ],
)
def test_fields_that_a_report_did_not_know_are_omitted(now: dict[str, Any], known: dict[str, Any]) -> None:
    assert known_fields(now, THEN) == known
