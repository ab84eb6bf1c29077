"""Absolute positions and distances before prints that are bowed, stretched, sheared or wrong in pitch.

Corners are simulated: a robot visits five ISO cube poses of one orientation, the camera sees a board that departs from
its nominal grid. Truth is where the camera was, mean over the cycles; of the pair of poses, their distance.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from benchmarks.table import Row
from benchmarks.trust.bowed_sessions import DEPARTURES, TYPICAL, Departure, Setup, simulate
from benchmarks.trust.shape_oracle import Oracle
from core.errors import GridposeError
from core.metrology import DistanceAssessment, PoseCycles, assess_distance
from core.session import (
    SessionEstimate,
    estimate_session,
)
from core.session.absolute_poses import absolute_poses, with_print_uncertainty


@dataclass
class Tally:
    """Errors over stated uncertainties; the interval of AD over that before a perfect print, and the same without the
    scatter of the cycles; the uncertainty of distances over an oracle's, and of the aspect over its prior's; the mean
    depth of a session's camera poses, and its uncertainty over that before a print taken as perfect.
    """

    distances: list[float] = field(default_factory=list)
    positions: list[float] = field(default_factory=list)
    intervals: list[float] = field(default_factory=list)
    widths: list[float] = field(default_factory=list)
    oracle: list[float] = field(default_factory=list)
    aspect: list[float] = field(default_factory=list)
    depths: list[float] = field(default_factory=list)
    depth_widths: list[float] = field(default_factory=list)
    refused: int = 0

    def add_depth(
        self, plain: SessionEstimate, printed: SessionEstimate, true: Mapping[str, np.ndarray]
    ) -> None:
        """Add a session's mean depth; images of one session share the errors of lens and print."""
        u = [
            float(np.mean([math.sqrt(p.covariance[2, 2]) for p in one.poses if p.covariance is not None]))
            for one in (plain, printed)
        ]
        error = float(np.mean([p.position_mm[2] - true[p.pose_id][2] for p in plain.poses]))
        self.depths.append(error / u[1])
        self.depth_widths.append(u[1] / u[0])


def measure(setup: Setup, departure: Departure, sessions: int, seed: int) -> Tally:
    """Return the tally over so many simulated sessions."""
    rng = np.random.default_rng(seed)
    tally = Tally()
    for _ in range(sessions):
        data, true = simulate(rng, setup, departure)
        try:
            estimate = estimate_session(data)
        except GridposeError:
            tally.refused += 1
            continue
        absolute = absolute_poses(data, estimate).poses
        tally.add_depth(estimate, with_print_uncertainty(data, estimate), true)
        alone = {pose.measurement_id: pose.common for pose in estimate.poses}
        of_pose: dict[str, list[str]] = {}
        for pose in estimate.poses:
            if pose.pose_id[0] == "P":
                of_pose.setdefault(pose.pose_id, []).append(pose.measurement_id)
        names = sorted(of_pose)
        means = {n: np.mean([absolute[i].position_mm for i in of_pose[n]], axis=0) for n in names}
        places = np.zeros(3), np.array([1.0, 0.0, 0.0])
        common = {n: absolute[of_pose[n][0]].common[:3] for n in names}
        bare = {n: alone[of_pose[n][0]][:3, :-1] for n in names}
        own = {
            n: np.mean([absolute[i].scatter[:3, :3] for i in of_pose[n]], axis=0) / len(of_pose[n])
            for n in names
        }
        for i, one in enumerate(names):
            tally.positions += list(
                (means[one] - true[one]) / np.sqrt(np.diag(common[one] @ common[one].T + own[one]))
            )
            for other in names[:i]:
                way = means[one] - means[other]
                e = way / np.linalg.norm(way)
                noise = float(e @ (own[one] + own[other]) @ e)
                u = math.sqrt(float(np.sum((e @ (common[one] - common[other])) ** 2)) + noise)
                u_bare = math.sqrt(float(np.sum((e @ (bare[one] - bare[other])) ** 2)) + noise)
                error = float(np.linalg.norm(way) - np.linalg.norm(true[one] - true[other]))
                tally.distances.append(error / u)
                tally.widths.append(u / u_bare)
                ends = [
                    PoseCycles(np.array([absolute[i].position_mm for i in of_pose[n]])) for n in (other, one)
                ]
                whole, perfect = (
                    assess_distance(
                        ends[0],
                        ends[1],
                        *places,
                        common_first=np.vstack([of[other], 0.0 * of[other]]),
                        common_second=np.vstack([of[one], 0.0 * of[one]]),
                    )
                    for of in (common, bare)
                )
                tally.intervals.append(_width(whole) / _width(perfect))
        if departure is DEPARTURES[0]:
            at = {pose.pose_id: absolute[pose.measurement_id] for pose in reversed(estimate.poses)}
            oracle = Oracle.of(data.targets[0], TYPICAL, at, setup.noise_px / math.sqrt(setup.cycles))
            tally.aspect.append(oracle.aspect)
            for i, one in enumerate(names):
                for other in names[:i]:
                    e = means[one] - means[other]
                    e /= np.linalg.norm(e)
                    u = math.sqrt(
                        float(
                            np.sum((e @ (common[one] - common[other])) ** 2) + e @ (own[one] + own[other]) @ e
                        )
                    )
                    tally.oracle.append(u / oracle.of_distance(one, other))
    return tally


def _width(found: DistanceAssessment) -> float:
    assert found.accuracy_interval_mm is not None
    return found.accuracy_interval_mm[1] - found.accuracy_interval_mm[0]


SETUPS = (
    ("five poses", Setup(), 54),
    ("and four tilted views", Setup(tilted_views=4), 36),
)


def trust_rows(seeds: Sequence[int], quick: bool) -> Iterator[Row]:
    """Yield for every departure the coverage of distances and positions, and how wide the intervals are."""
    for name, setup, whole in SETUPS:
        sessions = 4 if quick else max(whole // len(seeds), 1)
        for departure in DEPARTURES:
            found = [measure(setup, departure, sessions, seed) for seed in seeds]
            distances, positions = (
                np.concatenate([getattr(tally, part) for tally in found])
                for part in ("distances", "positions")
            )
            refused = sum(tally.refused for tally in found)
            note = f"{sessions * len(seeds)} sessions, {refused} refused; rms of error ÷ u"
            title = f"shape: {departure.name}, {name}"
            for what, errors in (("AD", distances), ("positions", positions)):
                covered = 100.0 * float(np.mean(np.abs(errors) < 1.96))
                rms = float(np.sqrt(np.mean(errors**2)))
                yield Row.at_least(f"{title}: coverage of {what}", covered, 90.0, "%", f"{note} {rms:.2f}")
            depths, grown = (
                np.concatenate([getattr(tally, part) for tally in found])
                for part in ("depths", "depth_widths")
            )
            covered = 100.0 * float(np.mean(np.abs(depths) < 1.96))
            rms, before = (float(np.sqrt(np.mean(one**2))) for one in (depths, depths * grown))
            yield Row.at_least(
                f"{title}: coverage of the depth of camera poses",
                covered,
                90.0,
                "%",
                f"{note} {rms:.2f}; {before:.2f} with the print taken as perfect; "
                f"{float(np.mean(grown)):.2f} times as wide",
            )
            if departure is DEPARTURES[0]:
                interval, width, oracle, aspect = (
                    float(np.median(np.concatenate([getattr(tally, part) for tally in found])))
                    for part in ("intervals", "widths", "oracle", "aspect")
                )
                stated = (
                    f"an oracle with the same priors: {width / oracle:.2f} of the distance without the scatter of the "
                    f"cycles, here {width:.2f}; what these views leave of the prior on the aspect: {aspect:.2f}"
                )
                yield Row.at_most(
                    f"{title}: interval of AD ÷ that of a print known to be perfect, median",
                    interval,
                    1.3,
                    "",
                    stated,
                )
                yield Row.at_most(
                    f"{title}: u of a distance ÷ that of an oracle with the same priors, median",
                    oracle,
                    1.15,
                    "",
                    "the oracle knows the noise and solves for everything at once: nobody can state less",
                )
