"""The warning that proposes a joint coupling which a session's poses show."""

from __future__ import annotations

from core.errors import Advisory
from core.kinematics import PoseData, propose_coupling
from core.session.model import SessionData


def coupling_proposal(data: SessionData, poses: PoseData) -> Advisory | None:
    """Return the warning `joint_coupling_proposed`; None where the robot states a coupling, or the poses show none."""
    if data.nominal is None or data.joint_coupling is not None:
        return None
    found = propose_coupling(poses, data.nominal)
    if found is None:
        return None
    terms = ", ".join(f"joint {k} follows joint {j} by {share:g}" for k, j, share in found.terms)
    options = " ".join(f"--joint-coupling {k}:{j}:{share:g}" for k, j, share in found.terms)
    return Advisory(
        "joint_coupling_proposed",
        f"The nominal robot is off the poses by {found.without_mm:.3g} mm, and by {found.with_it_mm:.3g} mm if "
        f"{terms}: the joints are probably coupled.",
        "Compare with the maker's documents and state joint_coupling with the robot (`gridpose robots change`, or "
        f"`create`: {options} after the joints).",
    )
