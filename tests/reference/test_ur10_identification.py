"""A real UR10 before a laser tracker: identified on a part of its poses, validated on the rest.

Data: christianlandgraf/ipa-robot-accuracy, MIT; 1,495 joint configurations over the robot's whole room, each with the
T-Mac's pose by a Leica tracker (mm; Euler angles in degrees, R = Rx Ry Rz; standard deviations of some hundredths of a
millimetre). Nominal DH parameters by the maker.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from core.kinematics import Blocking, Level, ModelChoice, joint_compliance
from core.kinematics.dh import forward
from core.kinematics.global_fit.blocks import clusters
from core.kinematics.identification import Identification, identify
from core.kinematics.pose_observations import PoseData
from tests.support.simulation.robots.arms import UR10, predicted_within_95, stated
from tests.support.simulation.robots.ur10_tracker import tracked


def position_rms(found: Identification, poses: PoseData) -> float:
    T = found.T_target_base[0] @ forward(found.chain, poses.joint_angles) @ found.T_flange_camera
    return float(np.sqrt(np.mean(np.sum((T[:, :3, 3] - poses.positions_mm) ** 2, axis=1))))


def test_poses_that_had_no_part_are_predicted_far_better_than_by_the_nominal(data_folder: Path) -> None:
    poses = tracked(data_folder)
    assert len(poses) == 1495
    part = np.arange(len(poses)) % 3 == 0
    found = identify(poses.take(np.flatnonzero(part)), UR10)
    rest = poses.take(np.flatnonzero(~part))
    # The nominal is off by 1.1 mm; what identification leaves, .45 mm, no rigid DH chain explains: gears and bending.
    assert position_rms(found, rest) < 0.5
    assert found.validation is not None
    assert found.validation.nominal is not None
    assert found.validation.nominal.position_rms_mm > 1.0
    assert found.validation.identified.position_rms_mm == pytest.approx(position_rms(found, rest), rel=0.1)


def test_the_parameters_stay_near_the_nominal(data_folder: Path) -> None:
    found = identify(tracked(data_folder), UR10, folds=0)
    off = found.chain.as_array() - UR10.as_array()
    # A UR10 is built to about a millimetre and a tenth of a degree.
    assert np.max(np.abs(off[:, [0, 2]])) < 2.0
    assert np.max(np.abs(off[:, [1, 3, 4]])) < math.radians(0.15)
    assert len(found.names) == 30
    assert tuple(group.sentence for group in found.null_space) == (
        "theta1 offset and d1 cannot be separated from the base transform.",
        "theta6 offset, d6, a6 and alpha6 cannot be separated from the tool transform.",
        "d2, d3 and d4 cannot be determined separately: joints 2, 3 and 4 are parallel.",
    )
    assert found.conditioning.condition_number < 100.0
    assert 0.1 < found.scatter_position_mm < 0.5


def test_two_halves_agree_within_their_stated_uncertainty(data_folder: Path) -> None:
    """Dealt at random: poses in a row differ by the grasp they belong to, and bending and gears follow that."""
    poses = tracked(data_folder)
    dealt = np.random.default_rng(1).permutation(len(poses))
    one, other = (identify(poses.take(np.sort(half)), UR10, folds=0) for half in np.array_split(dealt, 2))
    difference = (one.chain.as_array() - other.chain.as_array()).ravel()
    variance = []
    for found in (one, other):
        uncertainty = [u or math.nan for j in found.joints for u in j.standard_uncertainty.values()]
        variance.append(np.square(uncertainty))
    ratio = difference / np.sqrt(variance[0] + variance[1])
    assert np.sqrt(np.nanmean(ratio**2)) < 1.5


def test_positions_alone_do_nearly_as_well(data_folder: Path) -> None:
    poses = replace(tracked(data_folder), rotations=None)
    part = np.arange(len(poses)) % 3 == 0
    found = identify(poses.take(np.flatnonzero(part)), UR10, folds=0)
    assert position_rms(found, poses.take(np.flatnonzero(~part))) < 0.5


SPEED = """
import sys, time
from pathlib import Path
from tests.support.simulation.robots.arms import UR10, stated
from tests.support.simulation.robots.ur10_tracker import tracked
from core.kinematics.identification import identify

poses = tracked(Path(sys.argv[1]))
identify(poses, UR10)  # kernels compiled
took = []
for _ in range(3):
    begun = time.process_time()
    identify(poses, UR10)
    took.append(time.process_time() - begun)
print(min(took))
"""


@pytest.mark.slow
def test_all_1495_poses_take_no_longer_than_anyone_waits(data_folder: Path) -> None:
    """Validation included; in a process of its own with one thread, as the service runs its analyses."""
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    ran = subprocess.run(
        [sys.executable, "-c", SPEED, str(data_folder)],
        cwd=Path(__file__).parents[2],
        env=os.environ | threads,
        capture_output=True,
        text=True,
        check=True,
    )
    # s of processor time; .25 where this was written. The goal of 1 s is measured by `make bench`; this guards against
    # an answer that became many times slower, on build servers that are busy or old as well.
    assert float(ran.stdout) < 3.0


@pytest.fixture(scope="module")
def thinned(data_folder: Path) -> PoseData:
    poses = tracked(data_folder)
    return poses.take(np.arange(0, len(poses), 3))


@pytest.mark.slow
def test_gears_and_compliance_predict_what_the_chain_cannot(thinned: PoseData) -> None:
    found = identify(thinned, UR10, model=ModelChoice.AUTO)
    model, validation = found.error_model, found.validation
    assert model is not None
    assert validation is not None
    assert model.level is Level.ALL
    by = {block.blocking: block for block in validation.blocks}
    by_cluster = by[Blocking.CLUSTERS]
    assert validation.nominal is not None
    assert by_cluster.nominal is not None
    # .10 and .09 from a third of the poses; the chain alone leaves .4 of the nominal's error.
    assert validation.identified.position_rms_mm < 0.13 * validation.nominal.position_rms_mm
    assert by_cluster.identified.position_rms_mm < 0.2 * by_cluster.nominal.position_rms_mm
    # A study of this arm found .5 to 1.2e-5 rad/Nm in joints 2 and 3: a milliradian per metre for some 100 N beyond.
    about_own = {one.joint: one for one in joint_compliance(model) if one.axis == "z"}
    for joint in (2, 3):
        assert 0.3e-3 < about_own[joint].rad_per_m < 3e-3
    # Harmonic drives: a tail of some 6 mdeg up to about the twentieth harmonic, where the defaults have 1.
    _, tail, corner = model.fitted.hyperparameters.log_values[:3]
    assert 3.0 < math.degrees(1e3 * math.exp(0.5 * tail)) < 12.0
    assert 10.0 < math.exp(corner) < 40.0


@pytest.mark.slow
def test_halves_by_the_elbow_agree_within_what_the_model_states(data_folder: Path) -> None:
    """Where the chain alone contradicts itself by six stated uncertainties."""
    poses = tracked(data_folder)
    order = np.argsort(poses.joint_angles[:, 2], kind="stable")
    ratio = {}
    for model in (ModelChoice.DH, ModelChoice.EXTENDED):
        one, other = (
            identify(poses.take(np.sort(half)), UR10, folds=0, model=model)
            for half in np.array_split(order, 2)
        )
        off = one.chain.as_array() - other.chain.as_array()
        ratio[model] = float(np.sqrt(np.nanmean(np.square(off / np.hypot(stated(one), stated(other))))))
    assert ratio[ModelChoice.EXTENDED] < 1.5 < 4.0 < ratio[ModelChoice.DH]


@pytest.mark.slow
def test_positions_at_clusters_that_had_no_part_are_within_their_intervals(thinned: PoseData) -> None:
    """Of the ten clusters the largest four, which have two thirds of the poses."""
    inside = predicted_within_95(thinned, UR10, clusters(thinned.joint_angles), largest=4)
    assert inside.shape[1] > 0.6 * len(thinned)
    assert 0.9 < np.mean(inside) < 0.995
