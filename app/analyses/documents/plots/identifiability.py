"""The drawing of what a session's poses cannot determine of its robot: plain values for `app.reports.arm_schematic`."""

from __future__ import annotations

import string
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from app.analyses.documents.dh import identified
from app.reports.arm_schematic import JointAxis, LinkPart, UndeterminedGroup, arm_schematic_svg
from app.reports.forms import symbols
from core.kinematics import Chain, frames
from core.session import RobotIdentification, SessionData

_SYMBOLS = {"a_mm": "a", "alpha_rad": "α", "d_mm": "d", "theta_offset_rad": "θ", "beta_rad": "β"}


def identifiability_plot(data: SessionData, settings: Mapping[str, str], about: str) -> bytes:
    """Return what `GET .../dh/identifiability.svg` answers."""
    data, found = identified(data, {**settings, "method": "global"})
    chain = found.chain if data.nominal is None else data.nominal
    T, parts = _links(chain, _middle(found))
    axes = [JointAxis(i + 1, T[i, :3, 3], T[i, :3, 2]) for i in range(len(chain))]
    places = {part.name: 0.5 * (part.start_mm + part.end_mm) for part in parts}
    camera = (T[-1] @ found.T_flange_camera)[:3, 3]
    parts.append(LinkPart("tool", T[-1, :3, 3], camera))
    groups = [
        UndeterminedGroup(letter, _placed(group.parameters, T, places, camera), symbols(group.sentence))
        for letter, group in zip(_letters(), found.null_space, strict=False)
    ]
    title = "What these poses cannot determine" if groups else "These poses determine every parameter"
    return arm_schematic_svg(axes, parts, groups, title, about)


def _letters() -> list[str]:
    return [*string.ascii_uppercase, *(f"A{letter}" for letter in string.ascii_uppercase)]


def _middle(found: RobotIdentification) -> Float[np.ndarray, " j"]:
    """Return a configuration in the middle of where the joints were, rad."""
    return np.array([0.5 * (joint.minimum + joint.maximum) for joint in found.region])


def _links(
    chain: Chain, joint_angles: Float[np.ndarray, " j"]
) -> tuple[Float[np.ndarray, "k 4 4"], list[LinkPart]]:
    """Return the frames of the chain at these angles, and the lengths between them."""
    T = frames(chain, joint_angles[None])[0]
    parts = []
    for i, joint in enumerate(chain.joints):
        corner = T[i, :3, 3] + joint.d_mm * T[i, :3, 2]
        parts += [
            LinkPart(f"d{i + 1}", T[i, :3, 3], corner),
            LinkPart(f"a{i + 1}", corner, T[i + 1, :3, 3]),
        ]
    return T, parts


def _placed(
    keys: tuple[str, ...],
    T: Float[np.ndarray, "k 4 4"],
    places: Mapping[str, Float[np.ndarray, "3"]],
    camera: Float[np.ndarray, "3"],
) -> tuple[tuple[str, Float[np.ndarray, "3"]], ...]:
    """Return the names of parameters with where they are: lengths at their middle, angles at their axis, frames at
    their end of the arm.
    """
    found: dict[str, Float[np.ndarray, "3"]] = {}
    for key in keys:
        owner, _, parameter = key.partition(".")
        if owner.startswith("joint_"):
            joint = int(owner.removeprefix("joint_"))
            name = f"{_SYMBOLS[parameter]}{joint}"
            # θ turns about the axis before the link, α and β turn the next one against it.
            angle = T[joint - 1 if parameter == "theta_offset_rad" else joint, :3, 3]
            found[name] = places.get(name, angle)
        elif owner.startswith("flange_camera"):
            found["tool"] = camera
        else:
            found["base"] = T[0, :3, 3]
    return tuple(found.items())
