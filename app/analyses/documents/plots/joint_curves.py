"""The plot of a robot's joint curves: what was identified, as plain values for `app.reports.joint_curves`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from app.analyses.documents.dh import identified, level_document
from app.analyses.outcome import AnalysisError
from app.reports.joint_curves import JointCurvePanel, joint_curves_svg
from core.kinematics import joint_curves, visited_angles
from core.session import SessionData


def joint_curves_plot(data: SessionData, settings: Mapping[str, str], about: str) -> bytes:
    """Return what `GET .../dh/joint-curves.svg` answers. Raises AnalysisError where the model has no curves."""
    _, found = identified(data, {**settings, "method": "global"})
    model, level = found.error_model, level_document(found.error_model)
    curves = () if model is None else joint_curves(model)
    if model is None or level is None or not curves:
        reason = "the chain alone was asked for" if level is None else level["reason"]
        raise AnalysisError(
            "no_joint_curves",
            f"The identified model has no joint curves: {reason}",
            "model=extended takes all terms, whatever the evidence. More poses that differ in every joint let the data "
            "decide: 60 at least.",
        )
    visited = np.degrees(visited_angles(model))
    gaps = {joint.joint: np.degrees(joint.gaps).reshape(-1, 2).tolist() for joint in found.region}
    panels = [
        JointCurvePanel(
            f"joint {curve.joint}",
            np.degrees(curve.angles),
            np.degrees(curve.correction),
            np.degrees(curve.standard_uncertainty),
            np.unique(visited[:, curve.joint - 1].round(2)),
            [(low, high) for low, high in gaps.get(curve.joint, [])],
        )
        for curve in curves
    ]
    return joint_curves_svg(panels, "What each joint turns by beyond its stated angle", level["gain"], about)
