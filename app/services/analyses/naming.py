"""Grid points under one set of names for all images of a pose, before anything is computed from them.

A part of a chessboard that may be any part, and a board that looks the same when turned, are named by another image of
the same pose, before the same lens (`core.calibration.naming_parts`): by one that shows its origin, or else by the
first that shows the whole board. What stays unnamed of parts is left out, and said so. So are parts whose pose's named
images do not agree where the board stood, be it one of many that stands aside: nobody can say with which the part goes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from app.records.codec import decode_points, end_points, rename_points
from app.services.analyses.snapshot import Image, Snapshot
from core import Advisory, TargetSpec
from core.calibration.naming_parts import NEAR, Named, name_points, stands_with
from core.calibration.readings import quarter_turns
from core.targets.dot_sites import lines, sites_of
from core.targets.specification import GridPoints, Origin

ORIGIN_UNKNOWN = "origin_unknown"
NAMED = 5

Refusal = Literal["images_apart", "part_aside"]
"""Why a part is not named though its pose has a named image: these stand apart, or the part contradicts them."""


def origin_of(image: Image, target: TargetSpec) -> Origin:
    """Return how far an image's points are named for sure; of results from before that was kept, what the kind says."""
    if image.origin == "unknown":
        return "unknown"
    if image.origin is None:
        return "known" if len(quarter_turns(target)) == 1 else "turned"
    return "turned" if image.origin == "turned" else "known"


def name_alike(snapshot: Snapshot, points: Mapping[str, bytes]) -> tuple[Snapshot, dict[str, bytes]]:
    """Return the session with the points of each pose under one set of names; without the points of parts that no image
    of their pose names.
    """
    named, origins = dict(points), {}
    parts: set[str] = set()
    refused: dict[str, str] = {}
    targets = [TargetSpec(**fields) for fields in snapshot.targets]
    for members in _same_views(snapshot, points, targets):
        images = [snapshot.images[i] for i in members]
        target = targets[images[0].target]
        read = [_as_read(image, points[image.measurement_id], target) for image in images]
        found = _name(images, read, points, target, refused)
        for image, origin in zip(images, read, strict=True):
            if origin == "unknown" and image.measurement_id in found:
                parts.add(image.measurement_id)
            answer = found.get(image.measurement_id)
            if answer is not None:
                origins[image.measurement_id], named[image.measurement_id] = answer
            elif image.origin == "unknown":
                del named[image.measurement_id]
    if not origins and len(named) == len(points):
        return snapshot, named
    images = [
        replace(image, origin=origins.get(image.measurement_id, image.origin)) for image in snapshot.images
    ]
    named_alike = replace(snapshot, images=tuple(images), parts_named=frozenset(parts), parts_refused=refused)
    return named_alike, named


def _same_views(
    snapshot: Snapshot, points: Mapping[str, bytes], targets: Sequence[TargetSpec]
) -> list[list[int]]:
    """Return the images of each pose, target, lens and image size among which some are not named for sure."""
    together: dict[tuple[object, ...], list[int]] = {}
    open_groups: set[tuple[object, ...]] = set()
    for i, image in enumerate(snapshot.images):
        if not points.get(image.measurement_id):
            continue
        key = (image.pose_id, image.target, image.focus_group, image.width_px, image.height_px)
        together.setdefault(key, []).append(i)
        if origin_of(image, targets[image.target]) != "known":
            open_groups.add(key)
    return [members for key, members in together.items() if key in open_groups]


def _as_read(image: Image, stored: bytes, target: TargetSpec) -> Origin:
    """Return `origin_of` an image; of a part that has the grid's full columns and rows, that of the whole grid: its
    outermost squares alone are out of view, and its order is that of the right colours.
    """
    origin = origin_of(image, target)
    if origin != "unknown":
        return origin
    view = decode_points(stored, [], target, image.width_px, image.height_px)
    if tuple(np.ptp(sites_of(target, view.column, view.row), axis=0) + 1) != lines(target):
        return "unknown"
    return "known" if len(quarter_turns(target)) == 1 else "turned"


def _name(
    images: Sequence[Image],
    origins: Sequence[Origin],
    points: Mapping[str, bytes],
    target: TargetSpec,
    refused: dict[str, str],
) -> dict[str, tuple[Origin, bytes]]:
    """Return origin and points of the images of one pose that its reference names; without those it does not name, of
    which `refused` is told parts that it could name but for a contradiction.
    """
    whole = [i for i, origin in enumerate(origins) if origin != "unknown"]
    if not whole:
        return {}
    # The first that is sure, else the first that has most points: it serves all others.
    chosen = min(whole, key=lambda i: (origins[i] != "known", -len(points[images[i].measurement_id]), i))
    stored = [points[image.measurement_id] for image in images]
    reference = _decoded(images[chosen], stored[chosen], target, origins[chosen])
    cells, px = end_points(stored)
    # Whole boards mostly agree: two of their corners say so, without a look at the rest.
    far = NEAR * float(np.linalg.norm(px[chosen, 1] - px[chosen, 0]))
    agree = np.all(cells == cells[chosen], axis=(1, 2)) & np.all(
        np.linalg.norm(px - px[chosen], axis=2) < far, axis=1
    )
    answers: dict[str, tuple[Origin, bytes]] = {}
    for i in whole:
        image = images[i]
        if origins[i] == "known":
            answers[image.measurement_id] = "known", stored[i]
        elif i == chosen or agree[i]:
            answers[image.measurement_id] = origins[chosen], stored[i]
        else:
            found = name_points(_decoded(image, stored[i], target, origins[i]), reference)
            if isinstance(found, Named):
                answers[image.measurement_id] = origins[chosen], _renamed(stored[i], found)
    parts = [i for i, origin in enumerate(origins) if origin == "unknown"]
    if parts and not _stand_alike(images, [i for i in whole if i != chosen], answers, target, reference):
        refused.update((images[i].measurement_id, "images_apart") for i in parts)
        return answers
    for i in parts:
        image = images[i]
        found = name_points(_decoded(image, stored[i], target, "unknown"), reference)
        if isinstance(found, Named):
            answers[image.measurement_id] = origins[chosen], _renamed(stored[i], found)
        elif found == "aside":
            refused[image.measurement_id] = "part_aside"
    return answers


def _stand_alike(
    images: Sequence[Image],
    others: Sequence[int],
    answers: Mapping[str, tuple[Origin, bytes]],
    target: TargetSpec,
    reference: GridPoints,
) -> bool:
    """Tell whether a pose's named images all show the board where the reference does."""
    for i in others:
        answer = answers.get(images[i].measurement_id)
        if answer is None or not stands_with(_decoded(images[i], answer[1], target, answer[0]), reference):
            return False
    return True


def _renamed(stored: bytes, found: Named) -> bytes:
    return rename_points(stored, found.column, found.row) if found.changed else stored


def _decoded(image: Image, stored: bytes, target: TargetSpec, origin: Origin) -> GridPoints:
    view = decode_points(stored, [], target, image.width_px, image.height_px)
    return replace(view, origin=origin)


def naming_remarks(snapshot: Snapshot, unnamed: Sequence[Image]) -> list[Advisory]:
    """Say which images of parts count under the names of others, and which of them do not count."""
    remarks = []
    if snapshot.parts_named:
        parts = [image for image in snapshot.images if image.measurement_id in snapshot.parts_named]
        remarks.append(
            Advisory(
                "parts_named",
                f"{_images(len(parts))} part of a board; its grid points took their names from images of the same pose "
                f"that show the whole board: {_listed(parts)}. The names are right only if the board stood within half "
                "a square of the same place in them.",
                "Move to the same pose before each image of it; images of another pose need a pose_id of their own.",
            )
        )
    apart, aside = (
        [image for image in unnamed if snapshot.parts_refused.get(image.measurement_id) == why]
        for why in get_args(Refusal)
    )
    if apart:
        remarks.append(
            Advisory(
                "parts_disputed",
                f"{_images(len(apart))} part of a board, and the images of the same pose that could say which part "
                "contradict one another: they show the board more than a quarter of a square apart. Left out: "
                f"{_listed(apart)}.",
                "Find the images of the pose that show the board elsewhere (a wrong label, a pose taught anew, a board "
                "that was moved) and give those a pose_id of their own.",
            )
        )
    if aside:
        remarks.append(
            Advisory(
                "parts_aside",
                f"{_images(len(aside))} part of a board whose end or colours are not where the other images of the "
                f"same pose have them: the board stood whole squares aside. Left out: {_listed(aside)}.",
                "Check the label of these images, and whether the pose was taught anew or the board moved; give images "
                "of another place a pose_id of their own, with one that shows the whole board.",
            )
        )
    unnamed = [image for image in unnamed if image.measurement_id not in snapshot.parts_refused]
    if unnamed:
        remarks.append(
            Advisory(
                ORIGIN_UNKNOWN,
                f"{_images(len(unnamed))} part of a board, and no image of the same pose says which part: "
                f"{_listed(unnamed)}.",
                "Show the whole board in at least one image of each pose; or use a board whose origin can be told from "
                "a part: ChArUco, AprilGrid, or a chessboard with marked squares.",
            )
        )
    return remarks


def _images(count: int) -> str:
    return "One image shows" if count == 1 else f"{count} images show"


def _listed(images: Sequence[Image]) -> str:
    poses = list(dict.fromkeys(image.pose_id for image in images))
    more = f" and {len(poses) - NAMED} more" if len(poses) > NAMED else ""
    return f"{'pose' if len(poses) == 1 else 'poses'} {', '.join(poses[:NAMED])}{more}"
