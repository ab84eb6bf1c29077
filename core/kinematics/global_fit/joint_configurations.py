"""Joint configurations: which poses are visits to one and the same."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

SAME_CONFIGURATION = math.radians(0.05)
"""Joint angles no further apart are visits to one configuration."""


def configurations(
    joint_angles: Float[np.ndarray, "n j"],
    labels: Sequence[str] = (),
    tolerance: float = SAME_CONFIGURATION,
) -> Int[np.ndarray, " n"]:
    """Return the configuration of every pose, counted from 0 in the order of joint angles.

    Poses are of one configuration where none of their joints differs by more than `tolerance` (rad), where they have
    the same label, and where a chain of such poses leads from one to the other: single linkage, which has no borders
    for repeats to fall on either side of.
    """
    distinct, at = np.unique(joint_angles, axis=0, return_inverse=True)
    near = _linked(distinct, tolerance)[at.ravel()]
    if labels:
        _, named = np.unique(np.asarray(labels), return_inverse=True)
        count = int(near.max()) + 1
        component = _components(near, count + named.ravel(), count + int(named.max()) + 1)
        # Counted by the first of their joint angles, whatever the names are.
        _, first, of_component = np.unique(component[:count], return_index=True, return_inverse=True)
        near = np.argsort(np.argsort(first))[of_component.ravel()][near]
    return np.asarray(near)


def _components(
    one: Int[np.ndarray, " e"], other: Int[np.ndarray, " e"], count: int
) -> Int[np.ndarray, " n"]:
    """Return the connected component of each of `count` nodes; edge i joins one[i] and other[i]."""
    from scipy.sparse import (
        coo_array,
    )  # takes a while to load, with the next line, and few processes validate
    from scipy.sparse.csgraph import connected_components

    _, component = connected_components(
        coo_array((np.ones(len(one)), (one, other)), shape=(count, count)), directed=False
    )
    return np.asarray(component)


def _linked(points: Float[np.ndarray, "n j"], tolerance: float) -> Int[np.ndarray, " n"]:
    """Return the cluster of every point, counted by the first point of each.

    Points of one cell of a grid as wide as the tolerance agree, so that repeats, which would make very many pairs of
    points, make few pairs of cells. Two neighbouring cells are linked by their nearest points.
    """
    from scipy.cluster.hierarchy import DisjointSet  # takes a while to load

    grid = np.floor((points - points.min(axis=0, initial=0.0)) / tolerance)
    cells, cell = np.unique(grid, axis=0, return_inverse=True)
    cell = cell.ravel()
    members = np.split(np.argsort(cell, kind="stable"), np.cumsum(np.bincount(cell))[:-1])
    pairs = KDTree(cells).query_pairs(1.5, p=np.inf, output_type="ndarray")
    first = np.array([of_cell[0] for of_cell in members])
    near = (
        np.abs(points[first[pairs[:, 0]]] - points[first[pairs[:, 1]]]).max(axis=1, initial=0.0) <= tolerance
    )
    component = _components(pairs[near, 0], pairs[near, 1], len(cells))
    clusters = DisjointSet(range(int(component.max()) + 1))
    several = np.array([len(of_cell) > 1 for of_cell in members])
    for pair in pairs[~near & several[pairs].any(axis=1)]:
        one, other = component[pair].tolist()
        if not clusters.connected(one, other):
            few, many = sorted((points[members[of_pair]] for of_pair in pair), key=len)
            if KDTree(many).query(few, p=np.inf)[0].min() <= tolerance:
                clusters.merge(one, other)
    component = np.array([clusters[one] for one in range(int(component.max()) + 1)])[component]
    _, at_first, of_component = np.unique(component[cell], return_index=True, return_inverse=True)
    return np.asarray(np.argsort(np.argsort(at_first))[of_component.ravel()])
