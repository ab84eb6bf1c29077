"""Priors of single images against published calibrations, whole repositories held out.

Each width is fitted again without a fifth of the repositories, as the scale of a Student's t of which each repository
counts once, and the shipped prior is asked how many of the calibrations held out its 95 % holds. Published values
contain their own calibration's noise, so that a prior may be narrower than they are spread.

Of the principal point and of p1 and p2 that noise can be separated: two calibrations of one repository, of cameras of
one kind, each have noise of their own, and the mean of their product is the square of what they have in common.
"""

from __future__ import annotations

import csv
import itertools
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
SAME_KIND = 0.03, 0.08
"""Largest differences of log f / longer side and of k1 between calibrations of cameras of one kind."""
TRIMMED = 0.05  # of the repositories, at either end


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
    for name, products in _products(published).items():
        common = [_common(products, {r for r in products if fold[r] != k}) for k in range(FOLDS)]
        note = f"{len(products)} repositories with more than one calibration of a kind of camera, in {FOLDS} folds"
        low, high = min(common), max(common)
        yield Row(f"{name}: common to calibrations of the others", f"{low:.3g} to {high:.3g}", note=note)
        yield Row.context(f"{name}: common to calibrations of all", _common(products, set(products)))


def _column(published: list[dict[str, str]], name: str) -> Float[np.ndarray, " n"]:
    return np.array([float(row[name]) if row[name] else math.nan for row in published])


def _pairs(published: list[dict[str, str]]) -> dict[str, Float[np.ndarray, "2 n"]]:
    """Return the quantities with a part along u and one along v, zero if the lens is centred."""
    size = np.array([_column(published, "width"), _column(published, "height")])
    centre = np.array([_column(published, "cx"), _column(published, "cy")])
    return {
        "principal point / longer side": (centre - 0.5 * (size - 1.0)) / size.max(axis=0),
        "p1, p2": np.array([_column(published, "p1"), _column(published, "p2")]),
    }


def _values(published: list[dict[str, str]]) -> dict[str, Float[np.ndarray, " n"]]:
    """Return each quantity about its prior's mean, NaN where it is not stated; the two of a pair by turns of rows."""
    first = np.arange(len(published)) % 2 == 0
    by_turns = {name: np.where(first, *both) for name, both in _pairs(published).items()}
    return {
        "fx/fy": np.log(_column(published, "fx") / _column(published, "fy")),
        "log f / longer side": _log_focal(published) - MEANS["log f / longer side"],
        "k1": _column(published, "k1"),
        "k2": _column(published, "k2"),
    } | by_turns


def _log_focal(published: list[dict[str, str]]) -> Float[np.ndarray, " n"]:
    """Return log f / longer side of each calibration."""
    longer = np.maximum(_column(published, "width"), _column(published, "height"))
    return np.log(np.sqrt(_column(published, "fx") * _column(published, "fy")) / longer)


def _products(published: list[dict[str, str]]) -> dict[str, dict[str, float]]:
    """Return, by quantity and repository, the mean product of two of its calibrations of a kind of camera."""
    log_focal, k1, pairs = _log_focal(published), _column(published, "k1"), _pairs(published)
    tangential = pairs["p1, p2"]
    rows: dict[str, list[int]] = {}
    for i, row in enumerate(published):
        if np.all(np.isfinite(tangential[:, i])) and np.all(tangential[:, i] != 0.0):
            rows.setdefault(row["source_repo"], []).append(i)
    found: dict[str, dict[str, float]] = {name: {} for name in pairs}
    for repository, members in rows.items():
        same_kind = [
            (i, j)
            for i, j in itertools.combinations(members, 2)
            if abs(log_focal[i] - log_focal[j]) < SAME_KIND[0]
            and abs(k1[i] - k1[j]) < SAME_KIND[1]
            and tangential[0, i] != tangential[0, j]  # else it is one calibration, stored twice
        ]
        if same_kind:
            i, j = np.array(same_kind).T
            for name, both in pairs.items():
                found[name][repository] = float(np.mean(both[:, i] * both[:, j]))
    return found


def _common(products: dict[str, float], repositories: set[str]) -> float:
    """Return what calibrations have in common, each repository counted once: the root of the trimmed mean product."""
    ordered = np.sort([product for name, product in products.items() if name in repositories])
    cut = max(1, round(TRIMMED * len(ordered)))
    return math.sqrt(max(float(np.mean(ordered[cut:-cut])), 0.0))


def _scale(x: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"]) -> float:
    """Return the scale of the Student's t that is likeliest, its degrees of freedom free."""

    def cost(logs: Float[np.ndarray, "2"]) -> float:
        return -float(np.sum(weight * student.logpdf(x, math.exp(logs[0]), 0.0, math.exp(logs[1]))))

    start = np.array([1.0, math.log(float(np.median(np.abs(x))))])
    return math.exp(minimize(cost, start, method="Nelder-Mead").x[1])
