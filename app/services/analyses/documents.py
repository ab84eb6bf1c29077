"""Parts of documents that analyses share: cameras, remarks, and JSON without a NaN."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

import numpy as np

from app.services.analyses.estimation import FocusGroup
from core import Advisory
from core.camera import CAMERA_PARAMETERS


def encode(document: dict[str, Any]) -> bytes:
    """Return JSON; raises ValueError for NaN and infinities."""
    return json.dumps(document, allow_nan=False, ensure_ascii=False, separators=(",", ":")).encode()


def camera_fields(group: FocusGroup) -> dict[str, Any]:
    """Return a focus group's camera with its doubt."""
    estimate = group.estimate
    camera = dict(zip(CAMERA_PARAMETERS, estimate.camera.as_array().tolist(), strict=True))
    uncertainty = np.sqrt(np.maximum(np.diag(estimate.camera_covariance), 0.0)).tolist()
    return {
        "focus_group": group.name,
        "images": len(group.images),
        "intrinsics": {name: camera[name] for name in CAMERA_PARAMETERS[:4]},
        "distortion": {name: camera[name] for name in CAMERA_PARAMETERS[4:]},
        "standard_uncertainty": dict(zip(CAMERA_PARAMETERS, uncertainty, strict=True)),
        "reduced_chi2": estimate.reduced_chi2,
    }


def advisories(warnings: Iterable[Advisory]) -> list[dict[str, Any]]:
    """Return remarks, each once, in their order."""
    return [{"code": w.code, "detail": w.detail, "advice": w.advice} for w in dict.fromkeys(warnings)]
