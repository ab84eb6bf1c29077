"""Calibrate by mrcal: a program of its own for an interpreter that has mrcal, JSON in and out, started by
`benchmarks.public.photographs`. It imports nothing of Gridpose.

In: `points_px` (views, rows, columns, 2; null where a point was not seen), `spacing`, `size_px`, `warp` (whether the
board's bow is estimated). Out: focal length, rms, projection uncertainty at `query_px` (px, worst direction, standard
deviation, far away), seconds of seed and solve. The passes are those of mrcal-calibrate-cameras: geometry, then the
core, then the lens model, then the board's bow.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np

LENS = "LENSMODEL_OPENCV4"


def solve(problem: dict[str, Any]) -> dict[str, Any]:
    import mrcal  # type: ignore[import-not-found]  # Debian's package python3-mrcal, for the system's interpreter

    points = np.array(problem["points_px"], dtype=float)
    weight = np.where(np.isfinite(points[..., :1]), 1.0, -1.0)  # a negative weight marks what was not seen
    observations = np.ascontiguousarray(np.concatenate([np.nan_to_num(points), weight], axis=-1))
    sizes = np.array([problem["size_px"]], dtype=np.int32)
    frames = np.arange(len(points), dtype=np.int32)
    of_camera = np.stack([frames, np.zeros_like(frames)], axis=1)
    indices = np.stack([frames, np.zeros_like(frames), np.full_like(frames, -1)], axis=1)
    started = time.process_time()
    core, extrinsics, poses = mrcal.seed_stereographic(
        imagersizes=sizes,
        focal_estimate=float(max(problem["size_px"])),
        indices_frame_camera=of_camera,
        observations=observations,
        object_spacing=problem["spacing"],
    )
    inputs: dict[str, Any] = {
        "intrinsics": core,
        "extrinsics_rt_fromref": extrinsics,
        "frames_rt_toref": poses,
        "points": None,
        "observations_board": observations,
        "indices_frame_camintrinsics_camextrinsics": indices,
        "observations_point": None,
        "indices_point_camintrinsics_camextrinsics": None,
        "lensmodel": "LENSMODEL_STEREOGRAPHIC",
        "imagersizes": sizes,
        "calibration_object_spacing": problem["spacing"],
        "do_optimize_extrinsics": True,
        "do_optimize_frames": True,
        "do_optimize_intrinsics_core": False,
        "do_optimize_intrinsics_distortions": False,
        "do_optimize_calobject_warp": False,
        "do_apply_outlier_rejection": False,
        "do_apply_regularization": False,
    }
    mrcal.optimize(**inputs)
    inputs["do_optimize_intrinsics_core"] = True
    mrcal.optimize(**inputs)
    more = mrcal.lensmodel_num_params(LENS) - core.shape[-1]
    inputs["intrinsics"] = np.concatenate([inputs["intrinsics"], np.full((1, more), 1e-6)], axis=1)
    inputs["lensmodel"] = LENS
    for name in (
        "do_optimize_intrinsics_distortions",
        "do_apply_outlier_rejection",
        "do_apply_regularization",
    ):
        inputs[name] = True
    stats = mrcal.optimize(**inputs)
    if problem["warp"]:
        inputs["calobject_warp"] = np.zeros(2)
        inputs["do_optimize_calobject_warp"] = True
        stats = mrcal.optimize(**inputs)
    seconds = time.process_time() - started
    inputs["verbose"] = False
    model = mrcal.cameramodel(optimization_inputs=inputs, icam_intrinsics=0)
    query = mrcal.unproject(np.array(problem["query_px"]), *model.intrinsics(), normalize=True)
    spread = mrcal.projection_uncertainty(query, model, atinfinity=True, what="worstdirection-stdev")
    return {
        "focal_px": float(np.mean(inputs["intrinsics"][0, :2])),
        "rms_px": float(stats["rms_reproj_error__pixels"]),
        "projection_uncertainty_px": np.asarray(spread).tolist(),
        "seconds": seconds,
    }


if __name__ == "__main__":
    json.dump(solve(json.load(sys.stdin)), sys.stdout)
