"""A FANUC R-2000iC measured by a laser tracker: 24 poses, ten visits each, three reflectors (Sarrasor, MIT)."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from core.kinematics import Chain, JointParameters, PoseData

_QUARTER = math.pi / 2.0
FANUC = Chain(
    tuple(
        JointParameters(a, alpha, d, offset)
        for a, alpha, d, offset in (
            (312.0, -_QUARTER, 670.0, 0.0),
            (1075.0, 0.0, 0.0, 0.0),
            (225.0, -_QUARTER, 0.0, -_QUARTER),
            (0.0, _QUARTER, 1280.0, 0.0),
            (0.0, -_QUARTER, 0.0, 0.0),
            (0.0, 0.0, 0.0, 0.0),
        )
    )
)
"""The chain's angles are signs times the stated ones plus offsets."""
_SIGNS = np.array([1.0, 1.0, -1.0, -1.0, -1.0, -1.0])
_OFFSETS = np.array([0.0, -_QUARTER, _QUARTER, 0.0, 0.0, 0.0])


def fanuc_visits(data_folder: Path) -> PoseData:
    """Every visit's frame of the three reflectors, in the tracker's frame; the first is the point that is measured."""
    path = data_folder / "fanuc_r2000" / "calibration_dataset.mat"
    if not path.is_file():
        pytest.skip(f"{path.name} is not among the test data")
    read = loadmat(path)
    a, b, c = (1000.0 * read[name] for name in ("mA", "mB", "mC"))
    x = (b - a) / np.linalg.norm(b - a, axis=1)[:, None]
    z = np.cross(x, c - a)
    z = z / np.linalg.norm(z, axis=1)[:, None]
    pose = np.unique(np.round(read["q"], 6), axis=0, return_inverse=True)[1].ravel()
    return PoseData(
        read["q"] * _SIGNS + _OFFSETS,
        a,
        np.stack([x, np.cross(z, x), z], axis=2),
        labels=tuple(f"P{i}" for i in pose),
    )
