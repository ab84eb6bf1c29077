"""Priors of single images against published calibrations, whole repositories held out.

Each width is fitted again without a fifth of the repositories, as the scale of a Student's t of which each repository
counts once, and the shipped prior is asked how many of the calibrations held out its 95 % holds. Published values
contain their own calibration's noise, so that a prior may be narrower than they are spread.
"""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize
from scipy.stats import t as student

from benchmarks.table import Row
from core.calibration.priors import (
    ASPECT_PRIOR,
    FOCAL_PRIOR,
    PRINCIPAL_POINT_PRIOR,
    RADIAL_PRIORS,
    TANGENTIAL_PRIOR,
)

FOLDS = 5
MEANS = {"log f / longer side": FOCAL_PRIOR[0]}
WIDTHS = {
    "fx/fy": ASPECT_PRIOR,
    "principal point / longer side": PRINCIPAL_POINT_PRIOR,
    "log f / longer side": FOCAL_PRIOR[1],
    "k1": RADIAL_PRIORS[0],
    "k2": RADIAL_PRIORS[1],
    "p1, p2": TANGENTIAL_PRIOR,
}
NORMAL_95 = 1.959964


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    del seeds, quick  # nothing here is drawn, and it takes a second
    folder = Path(
        os.environ.get("GRIDPOSE_TEST_DATA", Path(__file__).parents[3] / "shared" / "data"),
    )
    path = folder / "published_calibrations" / "calibrations.csv"
    if not path.is_file():
        yield Row("published calibrations", "not here", note="set GRIDPOSE_TEST_DATA to the data's folder")
        return
    with path.open(encoding="utf-8", newline="") as file:
        published = [row for row in csv.DictReader(file) if row["model"] == "brown"]
    repositories = sorted({row["source_repo"] for row in published})
    fold = {name: k % FOLDS for k, name in enumerate(repositories)}
    values, of_repository = _values(published), np.array([row["source_repo"] for row in published])
    weight = 1.0 / np.array([int(np.sum(of_repository == name)) for name in of_repository])
    folds = np.array([fold[name] for name in of_repository])
    for name, x in values.items():
        scales, held, counted = [], 0.0, 0.0
        for k in range(FOLDS):
            usable = np.isfinite(x) & (x != 0.0)  # a value held at 0 is no calibration of it
            scales.append(_scale(x[usable & (folds != k)], weight[usable & (folds != k)]))
            out = usable & (folds == k)
            held += float(np.sum(weight[out] * (np.abs(x[out]) < NORMAL_95 * WIDTHS[name])))
            counted += float(np.sum(weight[out]))
        note = f"{len(published)} calibrations of {len(repositories)} repositories in {FOLDS} folds of whole ones"
        low, high = min(scales), max(scales)
        yield Row(f"{name}: width of the others, Student's scale", f"{low:.3g} to {high:.3g}", note=note)
        yield Row.context(f"{name}: the prior, 1 σ", WIDTHS[name])
        yield Row.context(f"{name}: held out, within the prior's 95 %", 100.0 * held / counted, "%")


def _values(published: list[dict[str, str]]) -> dict[str, Float[np.ndarray, " n"]]:
    """Return each quantity about its prior's mean, NaN where it is not stated; the two of a pair by turns of rows."""

    def column(name: str) -> Float[np.ndarray, " n"]:
        return np.array([float(row[name]) if row[name] else math.nan for row in published])

    fx, fy, width, height = column("fx"), column("fy"), column("width"), column("height")
    longer, first = np.maximum(width, height), np.arange(len(published)) % 2 == 0
    off_u, off_v = column("cx") - 0.5 * (width - 1.0), column("cy") - 0.5 * (height - 1.0)
    return {
        "fx/fy": np.log(fx / fy),
        "principal point / longer side": np.where(first, off_u, off_v) / longer,
        "log f / longer side": np.log(np.sqrt(fx * fy) / longer) - MEANS["log f / longer side"],
        "k1": column("k1"),
        "k2": column("k2"),
        "p1, p2": np.where(first, column("p1"), column("p2")),
    }


def _scale(x: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"]) -> float:
    """Return the scale of the Student's t that is likeliest, its degrees of freedom free."""

    def cost(logs: Float[np.ndarray, "2"]) -> float:
        return -float(np.sum(weight * student.logpdf(x, math.exp(logs[0]), 0.0, math.exp(logs[1]))))

    start = np.array([1.0, math.log(float(np.median(np.abs(x))))])
    return math.exp(minimize(cost, start, method="Nelder-Mead").x[1])
