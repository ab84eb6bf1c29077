"""Damaged files and mutated lattices through decoding and detection: an answer or our error, soon and in bounds."""

from __future__ import annotations

import os

import pytest

from tests.core.fuzz.campaign import Campaign, run_items


def of_sizes(few: int, slow: int) -> pytest.MarkDecorator:
    """Run a campaign over few items, over more where time allows, and over 50,000 on all processors."""
    return pytest.mark.parametrize(
        ("items", "processes"),
        [
            (few, 1),
            pytest.param(slow, 1, marks=pytest.mark.slow),
            pytest.param(50_000, os.cpu_count() or 1, id="soak", marks=pytest.mark.soak),
        ],
    )


def sound(kind: str, items: int, processes: int) -> Campaign:
    """Return a campaign that has run to its end without a finding."""
    campaign = run_items(kind, 0, items, processes=processes)
    assert not campaign.findings, "\n".join(campaign.findings)
    assert campaign.items == items
    return campaign


@of_sizes(40, 1000)
def test_damaged_files(items: int, processes: int) -> None:
    campaign = sound("file", items, processes)
    decoded = sum(count for outcome, count in campaign.outcomes.items() if outcome.startswith("decoded"))
    assert 0.05 * items < decoded < 0.5 * items  # most is refused, and much gets as far as the pixels


@of_sizes(60, 700)
def test_hostile_headers(items: int, processes: int) -> None:
    """Admission takes less than 8 MiB and .2 s of processor time for every one of them."""
    campaign = sound("header", items, processes)
    admitted = sum(count for outcome, count in campaign.outcomes.items() if outcome.startswith("admitted"))
    assert admitted > 0.2 * items  # many get past the header, and some as far as the pixels
    assert campaign.outcomes["admitted, decoded"] > 0.02 * items


@of_sizes(12, 100)
def test_mutated_lattices(items: int, processes: int) -> None:
    campaign = sound("lattice", items, processes)
    assert campaign.outcomes["found"] > 0.03 * items
    assert campaign.outcomes["target_not_found"] > 0.1 * items


@pytest.mark.slow
def test_the_watch_sees_what_it_is_for() -> None:
    campaign = run_items("planted", 0, 5, processes=2)
    seen = {int(finding.split()[1].rstrip(":")): finding for finding in campaign.findings}
    assert sorted(seen) == [1, 2, 3, 4]
    assert "ValueError: planted" in seen[1]
    assert "SIGPROF" in seen[2]
    assert "SIGSEGV" in seen[3]
    assert "grew by" in seen[4]
    asleep = run_items("planted", 5, 7, stuck_s=5.0)
    assert asleep.findings == ["planted 5: ended by no sign of life for 5 s"]
    assert asleep.outcomes["nothing"] == 1  # it goes on after that
