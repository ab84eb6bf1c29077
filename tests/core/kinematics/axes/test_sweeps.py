"""Sweeps are found whatever the order, the number of arcs and the chatter of resting joints."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

from core.errors import InvalidArgument, JointAnglesInconsistent, JointNotExcited
from core.kinematics.pose_observations import PoseData
from core.kinematics.sweeps import Sweep, find_sweeps, named_sweeps, require_sweeps
from core.simulation import free_angles, sweep_angles

HOME = np.radians([10.0, -60.0, 80.0, 5.0, 50.0, -20.0])


def poses_at(angles: np.ndarray, target: np.ndarray | None = None, labels: tuple[str, ...] = ()) -> PoseData:
    return PoseData(angles, np.zeros((len(angles), 3)), target=target, labels=labels)


def members(sweep: Sweep) -> set[int]:
    return set(sweep.poses.tolist())


def test_one_sweep_a_joint_with_home_in_all() -> None:
    sweeps = find_sweeps(poses_at(sweep_angles(HOME)))
    assert [s.joint for s in sweeps] == [0, 1, 2, 3, 4, 5]
    homes = {11 * joint + 5 for joint in range(6)}
    for joint, sweep in enumerate(sweeps):
        assert members(sweep) == set(range(11 * joint, 11 * joint + 11)) | homes
        assert np.all(np.diff(sweep.angles) >= 0.0)
        assert sweep.arc == pytest.approx(math.radians(80.0))
        others = np.delete(np.arange(6), joint)
        np.testing.assert_allclose(sweep.setting[others], HOME[others], atol=1e-12)


def test_order_cycles_chatter_and_free_poses_change_nothing() -> None:
    rng = np.random.default_rng(1)
    once = sweep_angles(HOME, steps=7)
    angles = np.concatenate([once, once, free_angles(rng, HOME, 40)])
    angles += rng.uniform(-1.0, 1.0, angles.shape) * math.radians(0.009)
    order = rng.permutation(len(angles))
    sweeps = find_sweeps(poses_at(angles[order]))
    assert [s.joint for s in sweeps] == [0, 1, 2, 3, 4, 5]
    for joint, sweep in enumerate(sweeps):
        # Two cycles of seven poses, and the ten homes of the other joints' sweeps.
        assert len(sweep.poses) == 14 + 10
        assert {int(order[p]) % 42 // 7 for p in sweep.poses if int(order[p]) % 7 != 3} == {joint}


def test_arcs_at_several_settings() -> None:
    other = HOME + np.radians([0.0, 15.0, 0.0, 0.0, 0.0, 0.0])
    angles = np.concatenate(
        [sweep_angles(HOME, joints=[0, 3], steps=5), sweep_angles(other, joints=[0], steps=4)]
    )
    sweeps = find_sweeps(poses_at(angles))
    assert [(s.joint, len(s.poses)) for s in sweeps] == [(0, 6), (0, 4), (3, 6)]
    assert sweeps[1].setting[1] == pytest.approx(other[1])


def test_a_sweep_on_two_targets_is_two() -> None:
    angles = sweep_angles(HOME, joints=[2], steps=8)
    sweeps = find_sweeps(poses_at(angles, np.array([0, 0, 0, 0, 1, 1, 1, 1])))
    assert [(s.target, sorted(members(s))) for s in sweeps] == [(0, [0, 1, 2, 3]), (1, [4, 5, 6, 7])]


def test_the_tolerance_is_what_others_may_differ_by() -> None:
    angles = sweep_angles(HOME, joints=[1], steps=5)
    angles[4, 3] += math.radians(0.05)
    assert [len(s.poses) for s in find_sweeps(poses_at(angles))] == [4]
    assert [len(s.poses) for s in find_sweeps(poses_at(angles), tolerance=math.radians(0.06))] == [5]
    with pytest.raises(InvalidArgument):
        find_sweeps(poses_at(angles), tolerance=0.0)


def test_a_creeping_joint_is_cut_not_chained() -> None:
    angles = np.tile(HOME, (30, 1))
    angles[:, 0] += np.radians(np.tile([0.0, 10.0, 20.0], 10))
    angles[:, 1] += np.radians(0.01) * np.repeat(np.arange(10), 3)  # each within the tolerance of the next
    sweeps = find_sweeps(poses_at(angles))
    assert {s.joint for s in sweeps} == {0}
    for sweep in sweeps:
        assert np.ptp(angles[sweep.poses, 1]) <= math.radians(0.02) + 1e-9
    assert len({p for s in sweeps for p in members(s)}) == 30


def test_repeated_poses_are_no_sweep() -> None:
    angles = np.concatenate([np.tile(HOME, (20, 1)), np.tile(HOME + 0.3 * np.eye(6)[0], (20, 1))])
    assert find_sweeps(poses_at(angles)) == ()


def test_joints_that_never_moved_are_named() -> None:
    sweeps = find_sweeps(poses_at(sweep_angles(HOME, joints=[0, 1, 3, 5])))
    with pytest.raises(JointNotExcited, match="joint 3, 5 "):
        require_sweeps(sweeps, 6)
    require_sweeps(find_sweeps(poses_at(sweep_angles(HOME))), 6)


def test_named_sweeps() -> None:
    angles = np.concatenate(
        [sweep_angles(HOME, joints=[0], steps=4), sweep_angles(HOME, joints=[1], steps=4)]
    )
    poses = poses_at(angles, labels=("a1", "a2", "a3", "a4", "b1", "b2", "b3", "b4"))
    (sweep,) = named_sweeps(poses, {1: [["b4", "b1", "b2"]]})
    assert sweep.poses.tolist() == [4, 5, 7]
    with pytest.raises(JointAnglesInconsistent, match="joint 2"):
        named_sweeps(poses, {0: [["a1", "a2", "a3", "b1"]]})
    with pytest.raises(JointNotExcited):
        named_sweeps(poses, {0: [["a1", "a2"]]})
    with pytest.raises(InvalidArgument, match="c9"):
        named_sweeps(poses, {0: [["a1", "c9"]]})
    with pytest.raises(InvalidArgument, match="no joint 7"):
        named_sweeps(poses, {6: [["a1"]]})


def test_many_poses_of_many_joints_are_quick() -> None:
    rng = np.random.default_rng(2)
    home = rng.uniform(-1.0, 1.0, 12)
    angles = np.concatenate([np.tile(sweep_angles(home), (9, 1)), free_angles(rng, home, 312)])
    poses = poses_at(angles[rng.permutation(1500)])
    start = time.process_time()
    sweeps = find_sweeps(poses)
    # Some 40 ms measured; pairwise comparison in Python would take minutes.
    assert time.process_time() - start < 2.0
    assert [len(s.poses) for s in sweeps] == [9 * 22] * 12
