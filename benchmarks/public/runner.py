"""Run detectors on rendered images."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.conditions import one_core
from benchmarks.public.adapters import Adapter, NotInstalled
from benchmarks.public.rendering import image_of
from benchmarks.public.scoring import Score, score
from benchmarks.public.suite import Item


def measure(
    adapters: Sequence[Adapter], suite: Sequence[Item], folder: Path
) -> tuple[dict[tuple[str, str], list[Score]], list[str]]:
    """Run every detector on every image, on one core; return scores by target and detector, and a sentence for each
    detector that could not run.

    Raises ValueError for an answer that breaks the contract.
    """
    scores: dict[tuple[str, str], list[Score]] = {}
    notes: dict[str, str] = {}
    with one_core():
        for name in dict.fromkeys(item.target_name for item in suite):
            of_target = [item for item in suite if item.target_name == name]
            for adapter in adapters:
                try:
                    found = run(adapter, of_target, folder)
                except NotInstalled as absent:
                    notes[adapter.name] = f"{adapter.name} has not been run. To add it: `{absent}`"
                    continue
                if found:
                    scores[name, adapter.name] = found
                    print(f"{name}: {adapter.name} done.", flush=True)
    return scores, list(notes.values())


def run(adapter: Adapter, suite: list[Item], folder: Path) -> list[Score]:
    """Run one detector on the images of one target; return no scores where it has no such target.

    Raises NotInstalled, and ValueError for an answer that breaks the contract.
    """
    prepared = adapter.prepare(suite[0].scene.target)
    if prepared is None:
        return []
    adapter.detect(prepared, image_of(suite[0], folder))  # loads and compiles what it does once
    answers = []
    for item in suite:
        image = image_of(item, folder)
        started = time.process_time()
        labels, points = adapter.detect(prepared, image)
        answers.append((item, labels, points, time.process_time() - started))
    size = suite[0].scene.target.size
    markers = any(len(labels) and int(np.max(labels)) >= size for _, labels, _, _ in answers)
    return [score(item, labels, points, markers, took) for item, labels, points, took in answers]
