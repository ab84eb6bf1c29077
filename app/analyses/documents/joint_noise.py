"""Joint noise of a session's robot as JSON: degrees and millimetres."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from app.analyses.documents.encoding import limits_of, refined_estimate
from app.analyses.documents.findings import Findings
from core.session import (
    NORMAL_FACTOR,
    PredictedScatter,
    RepeatabilityMap,
    SessionData,
    SessionJointNoise,
    assess_joint_noise,
)


def joint_noise_findings(data: SessionData, settings: Mapping[str, str]) -> Findings:
    """Return what `GET .../joint-noise` answers."""
    found = joint_noise_of(data, settings)
    joints = found.noise.joints
    fields = {
        "estimator": settings["estimator"],
        "source": settings["source"],
        "joint_noise": _joints(found),
        "remaining_scatter": _residual(found),
        "scatter_validation": {
            "scatter_ratio": found.held_out.chi_ratio,
            "rp_log_rms": found.held_out.rp_log_rms,
            "rp_log_expected": found.held_out.rp_log_expected,
            "constant_rp_log_rms": found.held_out.constant_rp_log_rms,
            "log_likelihood_gain": found.held_out.log_likelihood_gain,
            "log_likelihood_gain_standard_error": found.held_out.log_likelihood_gain_standard_error,
            "supported": found.held_out.supported,
        },
        "poses": [
            {"pose_id": pose.pose_id, "visits": pose.visits, "rp_ratio": pose.rp_ratio, **predicted}
            for pose, predicted in zip(
                found.poses,
                _predicted(found.at_poses, found.scatters.joint_angles),
                strict=True,
            )
        ],
        "predictions": []
        if found.at_angles is None
        else [
            {**predicted, "joint_angles_deg": angles}
            for angles, predicted in zip(
                json.loads(settings["at"]),
                _predicted(found.at_angles, np.zeros((len(found.at_angles.rp_l_mm), joints))),
                strict=True,
            )
        ],
        "worst_place": {
            **_predicted(found.map.worst, found.map.worst_joint_angles[None])[0],
            "position_mm": found.map.worst_position_mm.tolist(),
        },
        "repeatability_map": map_document(found.map),
        "limits_stated": list(found.limits_stated),
    }
    return Findings(fields, found.excluded, found.warnings)


def joint_noise_of(data: SessionData, settings: Mapping[str, str]) -> SessionJointNoise:
    """Return the joint noise by a request's settings."""
    estimate = refined_estimate(data, settings) if settings["source"] == "images" else None
    return assess_joint_noise(
        data, estimate, limits=limits_of(settings), at=json.loads(settings.get("at", "[]"))
    )


def map_document(found: RepeatabilityMap) -> dict[str, Any]:
    """Return the map's cells."""
    return {
        "cell_mm": found.cell_mm,
        "samples": found.samples,
        "repeatability_cells": [
            {
                "radius_mm": cell.radius_mm,
                "height_mm": cell.height_mm,
                "configurations": cell.configurations,
                "least_rp_l_mm": cell.least_rp_l_mm,
                "median_rp_l_mm": cell.median_rp_l_mm,
                "largest_rp_l_mm": cell.largest_rp_l_mm,
            }
            for cell in found.cells
        ],
    }


def _joints(found: SessionJointNoise) -> list[dict[str, Any]]:
    noise = found.noise
    low, high = (np.degrees(bound[: noise.joints]).tolist() for bound in noise.interval(NORMAL_FACTOR))
    sigma = np.degrees(noise.deviations[: noise.joints]).tolist()
    return [
        {
            "joint": joint + 1,
            "sigma_deg": sigma[joint] if seen else None,
            "interval_deg": [low[joint], high[joint]] if seen else None,
        }
        for joint, seen in enumerate(noise.identifiable.tolist())
    ]


def _residual(found: SessionJointNoise) -> dict[str, Any]:
    noise = found.noise
    rest = noise.deviations[noise.joints :]
    stated = bool(found.scatters.own.any())
    return {
        "position_sigma_mm": float(rest[0]),
        "rotation_sigma_deg": math.degrees(float(rest[1]) / noise.reach_mm) if len(rest) == 2 else None,
        "instrument_stated": stated,
    }


def _predicted(found: PredictedScatter, joint_angles: np.ndarray) -> list[dict[str, Any]]:
    low, high = found.interval()
    values, vectors = np.linalg.eigh(found.covariance_mm2)
    deviations = np.sqrt(np.maximum(values[:, ::-1], 0.0))
    axes = vectors[:, :, ::-1].transpose(0, 2, 1)
    return [
        {
            "joint_angles_deg": np.degrees(joint_angles[i]).tolist(),
            "rp_l_mm": float(found.rp_l_mm[i]),
            "standard_uncertainty_mm": float(found.standard_uncertainty_mm[i]),
            "interval_mm": [float(low[i]), float(high[i])],
            "ellipsoid": {"sigma_mm": deviations[i].tolist(), "axes": axes[i].tolist()},
            "joint_share": float(found.joint_share[i]),
            "rotation_sigma_deg": None
            if found.rotation_deviation is None
            else math.degrees(float(found.rotation_deviation[i])),
        }
        for i in range(len(found.rp_l_mm))
    ]
