"""What the tags of visits say that cannot be: which focus group, which cycle, which pose; and what follows for a pose.

The figures stay those of all visits that are stated to be of the pose, as ISO 9283 has it. No verdict is `robot` and
nothing is accepted where

- a pose was seen in several focus groups. The error of a lens cancels in the deviations from a pose's mean only where
  it is the same in all cycles; that of another group displaces its cycles. Deviations from the mean of each group would
  be free of it, but also of what the robot moved between the groups, which are mostly one after the other;
- visits share pose and cycle: images of one stop are no independent cycles;
- visits are copies: of one image, or equal to the last digit where readings are not rounded to a step;
- a visit lies at another pose (`core.metrology.find_misplaced_visits`), or whole pitches off, as that of a board whose
  points were counted from another one (`core.metrology.find_label_shifts`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from core.errors import Advisory, listed
from core.metrology import (
    FEW_CYCLES,
    REPEATED,
    PoseRepeatability,
    are_unchanging,
    find_label_shifts,
    find_misplaced_visits,
    find_resolution,
)
from core.session.model import CameraMount, MeasuredPose, natural
from core.session.repeatability.steadiness import not_steady, too_few_cycles, without_robot_verdict
from core.session.visits import positions_of, rotations_of
from core.targets import TargetSpec

MIXED_FOCUS = "seen in several focus groups"
MISPLACED = "with a visit that lies at another pose"
MISCOUNTED = "with a visit whose board was counted from another of its points"
COPIED = "with copies of visits"


@dataclass(frozen=True, slots=True)
class MistakenVisit:
    """A visit that lies at another pose, or whose board was counted off by `shift_mm` along its x and y; `distance_mm`
    is from its own pose, None where that has no place.
    """

    visit: MeasuredPose
    likely_pose_id: str | None
    distance_mm: float | None
    shift_mm: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class VisitTags:
    """By pose: the focus groups where there are several, and the cycles that have several visits; and the visits that
    lie at another pose. `counts` are the visits and the different ones of each pose that has repeated cycles or copies
    within it; `copied` are the poses with a visit that another one, of whatever pose, is a copy of.
    """

    mixed: Mapping[str, tuple[str, ...]]
    repeated: Mapping[str, tuple[int, ...]]
    counts: Mapping[str, tuple[int, int]]
    mistaken: tuple[MistakenVisit, ...]
    copied: tuple[str, ...]

    def flaw(self, pose_id: str) -> str | None:
        """Return why a pose's visits decide nothing; None where their tags do not speak against it."""
        if pose_id in self.repeated:
            return REPEATED
        if pose_id in self.copied:
            return COPIED
        if pose_id in self.mixed:
            return MIXED_FOCUS
        of_pose = [one for one in self.mistaken if one.visit.pose_id == pose_id]
        if not of_pose:
            return None
        return MISCOUNTED if all(one.likely_pose_id is None for one in of_pose) else MISPLACED

    def judged(self, pose_id: str, figures: PoseRepeatability) -> PoseRepeatability:
        """Return a pose's figures with the verdict that the tags of its visits leave."""
        flaw = self.flaw(pose_id)
        if flaw in (REPEATED, COPIED) and pose_id in self.counts:
            if self.counts[pose_id][1] < FEW_CYCLES:
                return too_few_cycles(figures)
            return not_steady(figures)
        return figures if flaw is None else without_robot_verdict(figures)


def visit_tags(
    visits: Mapping[str, Sequence[MeasuredPose]],
    targets: Sequence[TargetSpec] = (),
    mount: CameraMount = "robot",
) -> VisitTags:
    """Compare the tags of the visits that count, the images of a stop as one; those of images before the `targets`."""
    mixed, repeated, counts = {}, {}, {}
    for pose_id, of_pose in visits.items():
        groups = {visit.image.focus_group for visit in of_pose if visit.image is not None}
        if len(groups) > 1:
            mixed[pose_id] = tuple(sorted(groups, key=natural))
        times = Counter(visit.cycle for visit in of_pose if visit.cycle is not None)
        several = tuple(sorted(cycle for cycle, count in times.items() if count > 1))
        if several:
            repeated[pose_id] = several
            counts[pose_id] = len(of_pose), len(of_pose) - sum(times[cycle] - 1 for cycle in several)
    copied, different = _copies(visits)
    for pose_id, count in different.items():
        counts[pose_id] = len(visits[pose_id]), min(counts.get(pose_id, (0, count))[1], count)
    named = [pose_id for pose_id, of_pose in visits.items() if of_pose]
    found = find_misplaced_visits(
        [positions_of(visits[pose_id]) for pose_id in named], [visits[pose_id][0].frame for pose_id in named]
    )
    mistaken = tuple(
        MistakenVisit(visits[named[one.pose]][one.visit], named[one.likely_pose], one.distance_mm)
        for one in found
    )
    known = {id(one.visit) for one in mistaken}
    for pose_id in named:
        mistaken += tuple(
            one for one in _miscounted(visits[pose_id], targets, mount) if id(one.visit) not in known
        )
    return VisitTags(mixed, repeated, counts, mistaken, copied)


def _miscounted(
    visits: Sequence[MeasuredPose], targets: Sequence[TargetSpec], mount: CameraMount
) -> list[MistakenVisit]:
    """Return the visits of a pose that lie whole pitches off."""
    if visits[0].image is None or not targets:
        return []
    positions = positions_of(visits)
    off = positions - np.median(positions, axis=0)
    # Before a fixed camera positions are the board's, in the camera's axes.
    rotations = rotations_of(visits)
    in_board = off if mount == "robot" or rotations is None else np.einsum("nji,nj->ni", rotations, off)
    found = find_label_shifts(in_board, targets[visits[0].frame].points_target())
    return [
        MistakenVisit(visits[k], None, float(np.linalg.norm(off[k])), shift) for k, shift in found.items()
    ]


def _copies(visits: Mapping[str, Sequence[MeasuredPose]]) -> tuple[tuple[str, ...], dict[str, int]]:
    """Return the poses with copied visits, and how many different visits those with copies within them have."""
    contents = {pose_id: _contents(of_pose) for pose_id, of_pose in visits.items()}
    times = Counter(content for found in contents.values() for content in found)
    copied = tuple(p for p, found in contents.items() if any(times[one] > 1 for one in found))
    return copied, {p: len(set(contents[p])) for p in copied if len(set(contents[p])) < len(contents[p])}


def _contents(visits: Sequence[MeasuredPose]) -> list[object]:
    """Return what any two visits share only if one is a copy: their images, or all digits of a reading.

    Readings that do not change, or of a coarse display, tie by themselves, and are judged as such.
    """
    if visits and visits[0].image is None and len(visits) > 1:
        positions = positions_of(visits)
        if are_unchanging(positions) or find_resolution(positions) is not None:
            return []
    return [_content(visit) for visit in visits]


def _content(visit: MeasuredPose) -> object:
    if visit.image is not None:
        images = {one.image.image for one in visit.burst or (visit,) if one.image is not None}
        return visit.frame, frozenset(images)
    rotation = b"" if visit.rotation is None else visit.rotation.tobytes()
    return visit.frame, visit.position_mm.tobytes(), rotation


def tag_warnings(tags: VisitTags) -> list[Advisory]:
    """Name the poses, groups, cycles and visits."""
    warnings = []
    if shifted := [one for one in tags.mistaken if one.shift_mm is not None]:
        warnings.append(
            Advisory(
                "visit_label_shifted",
                f"Visits lie whole pitches of the board off their pose: {listed(_shifted(one) for one in shifted)}. "
                "Their points were most likely counted from another one than in the other images. The figures contain "
                "them. The verdict robot is withheld from these poses, and nothing is decided by them.",
                "Look at these images: what covers the board's ends, or a second board in view? Exclude them and take "
                "them again; a board with markers or a larger dot at its origin is counted right by any part.",
            )
        )
    if strayed := [one for one in tags.mistaken if one.likely_pose_id is not None]:
        named = listed(_mistaken(one) for one in strayed)
        of_images = any(one.visit.image is not None for one in strayed)
        warnings.append(
            Advisory(
                "visit_of_another_pose",
                f"Visits lie at another pose than the one they are stated to be of: {named}. The figures contain them. "
                "The verdict robot is withheld from these poses, and nothing is decided by them.",
                "Correct the pose_id of these visits (PATCH /v1/measurements/{measurement_id}, `gridpose measurements "
                "correct`), or exclude them. If the robot did go to the wrong pose, correct its program."
                if of_images
                else "Delete these readings (`gridpose measured-poses delete`) and store them under their pose. If the "
                "robot did go to the wrong pose, correct its program.",
            )
        )
    if tags.mixed:
        groups = listed(dict.fromkeys(group for found in tags.mixed.values() for group in found))
        warnings.append(
            Advisory(
                "focus_groups_mixed",
                f"{_poses(list(tags.mixed))}: the images are of several focus groups ({groups}). Each group has a "
                "camera of its own, whose error displaces all its cycles. It is in repeatability, distance "
                "repeatability and drift of these poses, whose verdict is not robot. Nothing is decided by them.",
                "Take all cycles of a pose in one focus group. Or put the images of each group into a session of their "
                "own, and look at its figures by themselves.",
            )
        )
    if tags.copied:
        warnings.append(
            Advisory(
                "visits_copied",
                f"{_poses(tags.copied)}: visits are copies, of one image or equal to the last digit, and each was "
                "taken for a visit of its own. Intervals are too narrow: nothing was measured again. The verdict robot "
                "is withheld, and nothing is decided by these poses.",
                "Exclude or delete the copies, and look at what wrote them: a folder that was uploaded twice, or a "
                "script that read the instrument before it had measured.",
            )
        )
    if tags.repeated:
        pose_id, cycles = next(iter(tags.repeated.items()))
        visits, different = tags.counts[pose_id]
        warnings.append(
            Advisory(
                "cycles_repeated",
                f"{_poses(list(tags.repeated))}: several visits state one cycle, and each was taken for a visit of its "
                f"own. Of {pose_id}, {visits} visits have {different} different cycles; several have cycle "
                f"{listed(str(cycle) for cycle in cycles)}. Intervals are too narrow if they are images of one stop. "
                "The verdict robot is withheld, and nothing is decided by these poses.",
                "Images of one stop: state burst 1, 2, ... with them. Visits of their own: give each its own cycle "
                "(`gridpose measurements correct`).",
            )
        )
    return warnings


def cycle_warnings(visits: Mapping[str, Sequence[MeasuredPose]]) -> list[Advisory]:
    """Say where nothing was repeated, or where nobody states that it was: no figure is to be read without this."""
    repeated = {pose_id: of_pose for pose_id, of_pose in visits.items() if len(of_pose) > 1}
    if not repeated:
        return [
            Advisory(
                "too_few_cycles",
                "Nothing was repeated: no pose has two visits that count. What is stated is no repeatability.",
                "Visit every pose again and state each visit's cycle: ISO 9283 asks for 30.",
            )
        ]
    untagged = [
        pose_id for pose_id, of_pose in repeated.items() if any(visit.cycle is None for visit in of_pose)
    ]
    if not untagged:
        return []
    every = len(untagged) == len(repeated) > 1
    named = "all poses" if every else f"{'pose' if len(untagged) == 1 else 'poses'} {listed(untagged)}"
    return [
        Advisory(
            "cycles_not_stated",
            f"Measurements of {named} state no cycle, and each was taken for a visit of its own. "
            "The figures are a repeatability only if the robot left the pose and came back between them.",
            "State the cycle of every measurement; images of one stop share their cycle (`gridpose measurements "
            "correct`).",
        )
    ]


def _named(visit: MeasuredPose) -> str:
    return f"{visit.pose_id} {'without a cycle number' if visit.cycle is None else f'cycle {visit.cycle}'}"


def _shifted(one: MistakenVisit) -> str:
    assert one.shift_mm is not None
    return f"{_named(one.visit)} ({one.shift_mm[0]:g} mm along x, {one.shift_mm[1]:g} mm along y)"


def _mistaken(one: MistakenVisit) -> str:
    far = "" if one.distance_mm is None else f", {one.distance_mm:.3g} mm from it"
    return f"{_named(one.visit)} (at {one.likely_pose_id}{far})"


def _poses(pose_ids: Sequence[str]) -> str:
    return f"{'Pose' if len(pose_ids) == 1 else 'Poses'} {listed(pose_ids)}"
