"""AprilTag 3 by the package pupil-apriltags: the corners of the tags of family 36h11.

It has no reading of an AprilGrid's tags, whose border is two cells wide.

References: J. Wang, E. Olson, "AprilTag 2: efficient and robust fiducial detection", IROS 2016,
10.1109/IROS.2016.7759617.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.public.adapters import NOTHING, Found, NotInstalled
from benchmarks.public.adapters.opencv_aruco import labels_of_markers

CLOCKWISE = [1, 0, 3, 2]
"""AprilTag's corners run counter-clockwise, on tags that are upside down against OpenCV's of the same family."""
PIXEL_CENTRE = 0.5
"""AprilTag's coordinates of the centre of the upper left pixel."""


def prepare(target: Any) -> Any | None:
    if target.kind != "charuco" or target.dictionary != "DICT_APRILTAG_36h11":
        return None
    try:
        from pupil_apriltags import Detector
    except ImportError as error:
        raise NotInstalled("pip install pupil-apriltags") from error
    detector = Detector(families="tag36h11", nthreads=1, quad_decimate=1.0, refine_edges=1)
    return detector, labels_of_markers(target)


def detect(prepared: Any, image: np.ndarray) -> Found:
    detector, labels = prepared
    seen = [tag for tag in detector.detect(image) if tag.tag_id < len(labels)]
    if not seen:
        return NOTHING
    corners = np.concatenate([tag.corners[CLOCKWISE] for tag in seen])
    return np.concatenate([labels[tag.tag_id] for tag in seen]), corners - PIXEL_CENTRE
