"""Coupled joints that the poses show: which joint's stated angle another joint of the chain follows.

In many arms joint 3 keeps its direction while joint 2 turns, and the wrist's joints turn one another. The chain's
angles are then C times the stated ones. Couplings of neighbouring joints are searched for one by one, each with the
usual ratios as starts, by how well the nominal robot with the best base and tool explains the poses; then all of them
are fitted together. One is proposed only where the nominal explains little without it, and the poses nearly with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.kinematics.dh import Chain
from core.kinematics.global_fit import Observations, observations_of
from core.kinematics.nominal_checks import NEAR, misfit
from core.kinematics.pose_observations import PoseData

MAX_COUPLINGS = 3
_STARTS = (1.0, -1.0, 0.5, -0.5, 0.2, -0.2)
_MAX_POSES = 60
"""Of all poses, evenly chosen: the couplings meant here move the camera by far more than any noise."""
_BETTER = 0.25
"""Of the misfit's square, which each coupling must bring."""
_FAR_BETTER = 0.04
"""Of the misfit's square without any coupling, to which all together must bring it."""
_FEW_POSES = 12
_EVALUATIONS = 40
"""Of the misfit, for each share that is fitted."""
_ROUND = 200.0
"""A ratio is proposed to a two-hundredth: it is a gear's, and the nominal is not exact."""


@dataclass(frozen=True, slots=True)
class ProposedCoupling:
    """C with the couplings found, `terms` as (joint that follows, joint that it follows, share), joints from 1.

    The nominal robot's misfit is `without` (with what is stated instead) and `with_it`, rms of position, mm.
    """

    matrix: Float[np.ndarray, "j j"]
    terms: tuple[tuple[int, int, float], ...]
    without_mm: float
    with_it_mm: float


def propose_coupling(poses: PoseData, nominal: Chain) -> ProposedCoupling | None:
    """Return the coupling with which the nominal robot explains the poses; None where it does so without one, or with
    none.
    """
    joints = len(nominal)
    seen = _some(poses, joints)
    if seen is None:
        return None
    extent = _extent(seen)

    def off(C: Float[np.ndarray, "j j"]) -> float:
        return _off(nominal, C, seen)

    none = np.eye(joints)
    first = least = off(none)
    if least < 2.0 * NEAR**2:
        return None
    places = [(k, j) for k in range(joints) for j in (k - 1, k + 1) if 0 <= j < joints]
    C, taken = none, list[tuple[int, int]]()
    while len(taken) < MAX_COUPLINGS:
        tried = {
            (place, share): off(_with(C, place, share))
            for place in places
            if place not in taken
            for share in _STARTS
        }
        place, share = min(tried, key=lambda one: tried[one])
        C, now = _fitted(_with(C, place, share), [*taken, place], off)
        if now > _BETTER * least:
            break
        taken, least = [*taken, place], now
    found = none.copy()
    for place in taken:
        found[place] = round(float(C[place]) * _ROUND) / _ROUND
    if not taken or off(found) > _FAR_BETTER * first:
        return None
    without, with_it = _position(nominal, none, seen), _position(nominal, found, seen)
    # A joint that counts the other way turns as one of twice its neighbour's share: rotations agree, positions do not.
    if with_it > max(NEAR * extent, math.sqrt(_FAR_BETTER) * without):
        return None
    terms = tuple((k + 1, j + 1, float(found[k, j])) for k, j in taken)
    return ProposedCoupling(found, terms, without, with_it)


def correct_coupling(
    poses: PoseData, nominal: Chain, stated: Float[np.ndarray, "j j"]
) -> ProposedCoupling | None:
    """Return the coupling with which the nominal robot explains poses that it does not explain with the stated one, of
    which the poses have the angles; no terms: without any. None where the stated one does, or no other.
    """
    plain = replace(poses, joint_angles=poses.joint_angles @ np.linalg.inv(stated).T)
    seen = _some(plain, len(nominal))
    if seen is None:
        return None
    first = _off(nominal, stated, seen)
    if first < 2.0 * NEAR**2:
        return None
    without_mm, none = _position(nominal, stated, seen), np.eye(len(nominal))
    with_none_mm = _position(nominal, none, seen)
    enough_mm = max(NEAR * _extent(seen), math.sqrt(_FAR_BETTER) * without_mm)
    if _off(nominal, none, seen) < _FAR_BETTER * first and with_none_mm < enough_mm:
        return ProposedCoupling(none, (), without_mm, with_none_mm)
    found = propose_coupling(plain, nominal)
    if found is None or found.with_it_mm > enough_mm:
        return None
    return replace(found, without_mm=without_mm)


def _some(poses: PoseData, joints: int) -> Observations | None:
    """Return some of the poses; None where they are too few, or of another robot."""
    if poses.joints != joints or len(poses) < _FEW_POSES:
        return None
    chosen = np.unique(np.linspace(0, len(poses) - 1, min(len(poses), _MAX_POSES)).astype(np.intp))
    seen = observations_of(poses).take(chosen)
    return seen if _extent(seen) > 0.0 else None


def _extent(seen: Observations) -> float:
    return float(np.linalg.norm(np.ptp(seen.positions_mm, axis=0)))


def _off(nominal: Chain, C: Float[np.ndarray, "j j"], seen: Observations) -> float:
    """Return the misfit's square, positions by the extent of the poses and rotations in rad."""
    found = misfit(nominal, seen.joint_angles @ C.T, seen)
    return (found.position_mm / _extent(seen)) ** 2 + found.rotation**2


def _fitted(
    C: Float[np.ndarray, "j j"],
    places: Sequence[tuple[int, int]],
    off: Callable[[Float[np.ndarray, "j j"]], float],
) -> tuple[Float[np.ndarray, "j j"], float]:
    """Return C with the shares at these places that suit the poses best, and how far off they are."""

    def at(shares: Float[np.ndarray, " k"]) -> Float[np.ndarray, "j j"]:
        changed = C.copy()
        for place, share in zip(places, shares, strict=True):
            changed[place] = share
        return changed

    from scipy.optimize import minimize  # takes a tenth of a second to load, and few processes fit robots

    start = np.array([C[place] for place in places])
    found = minimize(
        lambda shares: off(at(shares)),
        start,
        method="Nelder-Mead",
        options={"xatol": 1e-3, "fatol": 0.0, "maxfev": _EVALUATIONS * len(places)},
    )
    return at(found.x), float(found.fun)


def _with(C: Float[np.ndarray, "j j"], place: tuple[int, int], share: float) -> Float[np.ndarray, "j j"]:
    changed = C.copy()
    changed[place] = share
    return changed


def _position(nominal: Chain, C: Float[np.ndarray, "j j"], seen: Observations) -> float:
    return misfit(nominal, seen.joint_angles @ C.T, seen).position_mm
