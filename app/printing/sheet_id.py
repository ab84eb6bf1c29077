"""Id of a printed target: a hash of the pattern, whatever the name and options it was requested with."""

from __future__ import annotations

import dataclasses
import hashlib
import json

import cv2
import numpy as np

from core import TargetSpec
from core.targets import charuco_layout, marker_dictionary, spacing_mm


def sheet_id_of(target: TargetSpec, origin_dot: float = 1.0, marks: bool = False) -> str:
    """Return the id printed on a target's sheets: equal for equal prints only.

    Raises InvalidTarget for a ChArUco board that cannot be printed.
    """
    fields = dataclasses.asdict(_as_printed(target))
    for measured in (
        "pitch_standard_uncertainty_mm",
        "print_kind",
        "shape_standard_uncertainty",
        "certificate",
    ):
        fields.pop(measured)
    fields |= {"origin_dot": float(origin_dot) if origin_dot != 1.0 else None, "marks": marks}
    # Fields at their defaults are omitted, so that a new field does not change the ids of earlier sheets.
    described = {key: value for key, value in sorted(fields.items()) if value}
    return f"gp-{hashlib.sha256(json.dumps(described).encode()).hexdigest()[:8]}"


def _as_printed(target: TargetSpec) -> TargetSpec:
    """Return the shortest description of the same print: without fields equal to their defaults."""
    marker_mm = None if target.marker_mm is None else float(target.marker_mm)
    printed = dataclasses.replace(target, pitch_mm=float(target.pitch_mm), marker_mm=marker_mm)
    if target.kind in ("circles", "asymmetric_circles") and marker_mm == 0.5 * spacing_mm(target):
        return dataclasses.replace(printed, marker_mm=None)
    if target.kind == "aprilgrid":
        return dataclasses.replace(printed, dictionary=None)
    if target.kind == "charuco":
        today = dataclasses.replace(printed, legacy_layout=False)
        if np.array_equal(charuco_layout(target).black, charuco_layout(today).black):
            printed = today
        return dataclasses.replace(printed, dictionary=_least_dictionary(target))
    return printed


def _least_dictionary(target: TargetSpec) -> str:
    """Return the smallest dictionary with the same markers as a ChArUco board, by its first name.

    Dictionaries of one marker size begin with the same markers, and some have two names.
    """
    markers = len(charuco_layout(target).marker_squares)
    wanted = marker_dictionary(target).bytesList[:markers]
    sizes = {}
    for name in dir(cv2.aruco):
        if name.startswith("DICT_"):
            images = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)).bytesList
            if np.array_equal(images[:markers], wanted):
                sizes[name] = len(images)
    return min(sizes, key=lambda name: (sizes[name], name))
