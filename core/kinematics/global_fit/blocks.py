"""Blocks of joint space: poses that lie together, held out together.

A pose held out at random has neighbours among those that are left, and shares with them whatever the model lacks. A
block has none: what a fit of the others says of it is what the fit is worth where nothing was measured.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from enum import StrEnum

import numpy as np
from jaxtyping import Float, Int

from core.kinematics.arm_model import ArmState
from core.kinematics.dh import chain_frames
from core.kinematics.global_fit.joint_configurations import configurations

PARTS = 4
"""Blocks along the elbow's angle, the end's height, and the order of measuring."""
MAX_PART = 0.5
"""Of the configurations: a quarter with more of them does not count. In sweeps the elbow has one angle at most poses,
and the others do not determine an arm.
"""
_POSES_A_CLUSTER = 20
_FEWEST_CLUSTERS, _MOST_CLUSTERS = 4, 10
_ELBOW = 2  # the third joint of an arm; of shorter chains the last
_SEED = 9283


class Blocking(StrEnum):
    """What poses of one block have in common."""

    ELBOW = "elbow"
    HEIGHT = "height"
    ORDER = "order"
    CLUSTERS = "clusters"


def blocks_of(
    arm: ArmState, joint_angles: Float[np.ndarray, "n j"], labels: Sequence[str] = ()
) -> dict[Blocking, Int[np.ndarray, " n"]]:
    """Return the block of each pose, counted from 0, for every blocking that the poses allow.

    Poses are in the order in which they were measured; all of one configuration (`configurations`) are in one block.
    Fewer than 80 configurations have no blocks; quarters of the elbow's angle or of height count where none has more
    than half of them.
    """
    _, first, visited = np.unique(
        configurations(joint_angles, labels), return_index=True, return_inverse=True
    )
    if len(first) < _FEWEST_CLUSTERS * _POSES_A_CLUSTER:
        return {}
    some = joint_angles[first]
    T = chain_frames(arm.parameters, some)[:, -1] @ arm.T_flange_camera
    found = {
        Blocking.ELBOW: _parts(some[:, min(_ELBOW, some.shape[1] - 1)]),
        Blocking.HEIGHT: _parts(T[:, 2, 3]),
        Blocking.ORDER: _parts(first.astype(np.float64)),
        Blocking.CLUSTERS: clusters(some),
    }
    most = {name: MAX_PART * len(first) for name in (Blocking.ELBOW, Blocking.HEIGHT, Blocking.ORDER)}
    return {
        name: block[visited]
        for name, block in found.items()
        if int(block.max()) > 0 and int(np.bincount(block).max()) <= most.get(name, len(first))
    }


def clusters(joint_angles: Float[np.ndarray, "n j"]) -> Int[np.ndarray, " n"]:
    """Return the cluster of each configuration in joint space, by k-means on angles in units of their spread.

    References: D. Arthur, S. Vassilvitskii, "k-means++: the advantages of careful seeding", SODA 2007.
    """
    from scipy.cluster.vq import kmeans2  # takes a tenth of a second to load, and few processes validate

    count = int(np.clip(len(joint_angles) // _POSES_A_CLUSTER, _FEWEST_CLUSTERS, _MOST_CLUSTERS))
    spread = joint_angles.std(axis=0)
    unit = joint_angles / np.where(spread > 0.0, spread, 1.0)
    with warnings.catch_warnings():  # a cluster that runs empty is one cluster less
        warnings.simplefilter("ignore", UserWarning)
        _, label = kmeans2(unit, count, minit="++", rng=np.random.default_rng(_SEED))
    return np.unique(label, return_inverse=True)[1].ravel()


def _parts(values: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Return the quarter that each value is in; equal values are in one."""
    borders = np.quantile(values, np.arange(1, PARTS) / PARTS)
    return np.unique(np.searchsorted(borders, values, side="left"), return_inverse=True)[1].ravel()
