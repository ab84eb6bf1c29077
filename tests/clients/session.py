"""The session that each client measures: images of a robot that scatters by a millimetre, and its true RP_l."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from core.metrology import position_repeatability
from tests.support.contract.cell import TARGET, take_images

POSES, CYCLES = 2, 3
_JOINT_REPEATABILITY_RAD = 5e-4  # ten times a real robot's: figures far above the camera's noise
_TOLERANCE = 0.1


def write_session(folder: Path) -> Path:
    """Render the images into a folder; return the manifest, which has all that a client needs but URL and key."""
    folder.mkdir(parents=True, exist_ok=True)
    taken = take_images(
        POSES, repeated=POSES, cycles=CYCLES, joint_repeatability_rad=_JOINT_REPEATABILITY_RAD
    )
    for image in taken:
        (folder / image.filename).write_bytes(image.data)
    positions = np.array([image.T_target_camera[:3, 3] for image in taken if image.pose_id == "P1"])
    manifest = {
        "target": TARGET,
        "cycles": CYCLES,
        "rp_l_mm": position_repeatability(positions),
        "tolerance": _TOLERANCE,
        "images": [
            {
                "path": str(folder / image.filename),
                "pose_id": image.pose_id,
                "cycle": image.cycle,
                "sha256": image.sha256,
            }
            for image in taken
        ],
    }
    path = folder / "manifest.json"
    path.write_text(json.dumps(manifest, indent=1), encoding="utf-8")
    return path
