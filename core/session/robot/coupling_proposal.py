"""The warning that proposes a joint coupling which a session's poses show, in the place of none or of a stated one."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from core.errors import Advisory, listed
from core.kinematics import PoseData, ProposedCoupling, correct_coupling, propose_coupling
from core.session.model import SessionData

CODE = "joint_coupling_proposed"


def coupling_proposal(data: SessionData, poses: PoseData) -> Advisory | None:
    """Return the warning `joint_coupling_proposed`; None where the robot's coupling, or that it has none, suits the
    poses, or no other does.
    """
    if data.nominal is None:
        return None
    if data.joint_coupling is not None:
        found = correct_coupling(poses, data.nominal, data.joint_coupling)
        return None if found is None else _instead_of(data.joint_coupling, found)
    found = propose_coupling(poses, data.nominal)
    if found is None:
        return None
    return Advisory(
        CODE,
        f"The nominal robot is off the poses by {found.without_mm:.3g} mm, and by {found.with_it_mm:.3g} mm if "
        f"{_in_words(found.terms)}: the joints are probably coupled.",
        "Compare with the maker's documents and state joint_coupling with the robot (`gridpose robots change`, or "
        f"`create`: {_options(found)} after the joints).",
    )


def stated_coupling(coupling: Float[np.ndarray, "j j"]) -> str:
    """Return a coupling in words: which joint follows which, and by how much."""
    off = coupling - np.diag(np.diag(coupling))
    follows = _in_words((int(k) + 1, int(j) + 1, float(off[k, j])) for k, j in np.argwhere(off != 0.0))
    turns = [
        f"joint {k + 1} turns by {share:g} times its angle"
        for k, share in enumerate(np.diag(coupling))
        if share != 1.0
    ]
    return listed([*([follows] if follows else []), *turns])


def _instead_of(stated: Float[np.ndarray, "j j"], found: ProposedCoupling) -> Advisory:
    other = f"if {_in_words(found.terms)}" if found.terms else "without any coupling"
    if found.terms:
        remedy = f"correct the coupling of the robot (`gridpose robots change`: {_options(found)} after the joints)"
    else:
        remedy = "take the coupling from the robot (PATCH /v1/robots/{robot_id}: joint_coupling null)"
    return Advisory(
        CODE,
        f"With the joint coupling that the robot states ({stated_coupling(stated)}) the nominal robot is off the poses "
        f"by {found.without_mm:.3g} mm, and by {found.with_it_mm:.3g} mm {other}: the coupling is probably wrong, or "
        "the controller states the angles of the chain's joints.",
        f"Compare with the maker's documents and {remedy}.",
    )


def _in_words(terms: Iterable[tuple[int, int, float]]) -> str:
    return listed([f"joint {k} follows joint {j} by {share:g}" for k, j, share in terms])


def _options(found: ProposedCoupling) -> str:
    return " ".join(f"--joint-coupling {k}:{j}:{share:g}" for k, j, share in found.terms)
