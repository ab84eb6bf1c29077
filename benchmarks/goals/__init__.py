"""The numbers to reach, and what stored runs say about each."""

from __future__ import annotations

from benchmarks.goals.evaluation import Outcome, judge, judged, outcomes_table
from benchmarks.goals.goal import Goal, Part
from benchmarks.goals.registry import GOALS
from benchmarks.goals.stored import Section, sections_of

__all__ = ["GOALS", "Goal", "Outcome", "Part", "Section", "judge", "judged", "outcomes_table", "sections_of"]
