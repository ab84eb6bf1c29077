"""Intervals of AP where poses tie the frames askew: leverages below none or above all of a pose."""

from __future__ import annotations

import numpy as np

from core.metrology.accuracy import MeanNoise, TiedDeviations, estimate_deviations, tied_accuracy


def test_every_figure_lies_in_an_interval_of_some_width() -> None:
    rng = np.random.default_rng(1)
    residuals = rng.normal(0.0, 0.4, (3, 3))
    residuals[0, 2] = 1e-3  # the frames follow this pose there
    leverage = np.array([np.diag([0.3, 0.5, 1.4]), np.diag([-0.6, 0.4, 0.5]), np.diag([0.5, 0.4, 0.6])])
    noise = MeanNoise(np.full(3, 0.05), np.full(3, np.inf))
    tied = TiedDeviations(residuals, leverage, np.zeros((3, 3, 1)), np.full(3, True), noise)
    for place in estimate_deviations(tied):
        assert place.parts is not None
        assert np.linalg.eigvalsh(place.parts.own)[0] > 0.0
        accuracy = tied_accuracy(place, place, np.eye(3), None, tied.degrees_of_freedom)
        assert accuracy is not None
        for (name, figure), (_, interval) in zip(
            accuracy.figures.items(), accuracy.interval.items(), strict=True
        ):
            assert figure is not None
            assert interval is not None
            assert interval[0] <= figure <= interval[1], name
            assert interval[1] - interval[0] > 0.1, name
