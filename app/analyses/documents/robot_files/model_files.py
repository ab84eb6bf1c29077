"""An identified robot as URDF, Robotics Toolbox model, YAML and CSV.

All have the same forward kinematics, T_{i-1,i} = Rz(θ_i + offset_i) Tz(d_i) Tx(a_i) Rx(α_i) Ry(β_i), in full double
precision. URDF and the toolbox use metres and radians.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from app.markup import comment_text, quoted_attribute
from app.records.numbers import DH_PARAMETERS
from core.geometry import rotation_to_rpy, so3_exp, transform
from core.kinematics import link_transform

Json = dict[str, Any]
CSV_COLUMNS = (
    "joint",
    "name",
    *DH_PARAMETERS,
    *(f"u_{name}" for name in DH_PARAMETERS),
    *(f"nominal_{name}" for name in DH_PARAMETERS[:4]),
    *(f"identifiable_{name}" for name in DH_PARAMETERS),
    "parallel_to_next",
)
_FRAMES = ("flange_camera", "base_targets", "base_camera", "flange_targets")


@dataclass(frozen=True, slots=True)
class Model:
    """The answer of `GET .../dh`, and the robot's names and limits (deg) of joints, None for continuous joints."""

    document: Json
    name: str
    joint_names: tuple[str, ...]
    limits_deg: tuple[tuple[float, float] | None, ...]
    with_camera: bool

    @property
    def joints(self) -> Sequence[Json]:
        joints: Sequence[Json] = self.document["joints"]
        return joints


def names_of(stored: Sequence[str | None]) -> tuple[str, ...]:
    """Return the names of a robot's joints; one without a name gets its number."""
    return tuple(
        name if name is not None else _unused_name(f"joint_{i}", stored) for i, name in enumerate(stored, 1)
    )


def ranges_of(
    stored: Sequence[tuple[float | None, float | None]],
) -> tuple[tuple[float, float] | None, ...]:
    """Return the ranges of a robot's joints, degrees; None for continuous ones."""
    return tuple(None if low is None or high is None else (low, high) for low, high in stored)


def write_urdf(model: Model) -> str:
    """Return a URDF with the links base_link, link_1 ..., flange, and camera if requested and identified.

    A URDF's joint is a fixed transform followed by the rotation about its axis: the fixed transform of each joint holds
    the link of the joint before it. Where joints are coupled, each further share of a stated angle in a joint's turn is
    a joint about the same axis that mimics the one whose angle it is.
    """
    lines = ['<?xml version="1.0" encoding="utf-8"?>', f"<robot name={quoted_attribute(model.name)}>"]
    lines += [f"  <!-- {comment_text(line)} -->" for line in _provenance(model)]
    count = len(model.joints)
    names = ["base_link", *(f"link_{i}" for i in range(1, count + 1)), "flange"]
    fixed, taken = np.eye(4), list(model.joint_names)
    for i, joint in enumerate(model.joints):
        offset = so3_exp(np.array([0.0, 0.0, _radians(joint["theta_offset_deg"])]))
        origin = fixed @ transform(offset, np.zeros(3))
        kind, limit, limits = "continuous", "", model.limits_deg[i]
        if limits is not None:
            low, high = map(math.radians, limits)
            kind = "revolute"
            limit = f'<limit lower="{low!r}" upper="{high!r}" effort="0" velocity="0"/>'
        shares = _mimicked(model, i)
        between = [f"link_{i + 1}_of_{j + 1}" for j, _ in shares]
        names += between
        turned = [names[i], *between, names[i + 1]]
        # The joint itself comes last, so that the links between have the place of the joint's origin.
        for (j, share), parent, child in zip(shares, turned, turned[1:], strict=False):
            name = _unused_name(f"{model.joint_names[i]}_of_{model.joint_names[j]}", taken)
            taken.append(name)
            led = quoted_attribute(model.joint_names[j])
            mimic = f'<mimic joint={led} multiplier="{share!r}" offset="0"/>'
            lines += _joint(name, "continuous", parent, child, origin, mimic)
            origin = np.eye(4)
        lines += _joint(model.joint_names[i], kind, turned[-2], names[i + 1], origin, limit)
        fixed = _link(joint)
    name = _unused_name("flange_joint", taken)
    lines += _joint(name, "fixed", names[count], "flange", fixed, "", axis=False)
    camera = model.document["flange_camera"] if model.with_camera else None
    if camera is not None:  # one that is fixed is no part of the robot
        name, T = _unused_name("camera_joint", taken), _metres(camera["T_flange_camera"])
        lines += _joint(name, "fixed", "flange", "camera", T, "", axis=False)
        names.append("camera")
    lines += [f'  <link name="{name}"/>' for name in names]
    return "\n".join([*lines, "</robot>", ""])


def _mimicked(model: Model, i: int) -> list[tuple[int, float]]:
    """Return whose stated angles turn joint i in addition to its own angle, and by which share."""
    coupling = model.document["joint_coupling"]
    if coupling is None:
        return []
    shares = np.array(coupling[i], dtype=np.float64) - np.eye(len(coupling))[i]
    return [(j, float(share)) for j, share in enumerate(shares) if share != 0.0]


def write_roboticstoolbox(model: Model) -> str:
    """Return Python for Peter Corke's Robotics Toolbox; `robot` is the model.

    DHRobot has no β, which nearly parallel axes have: the model is then an elementary transform sequence.
    """
    head = [f"# {line}" for line in (model.name, *_provenance(model))]
    if any(joint["beta_deg"] is not None for joint in model.joints):
        body = ["from roboticstoolbox import ET, ERobot", "", "steps = ("]
        for i, joint in enumerate(model.joints):
            a, alpha, d, offset, beta = _si(joint)
            steps = [f"ET.Rz({offset!r})", f"ET.Rz({_limits(model, i)})", f"ET.tz({d!r})", f"ET.tx({a!r})"]
            steps += [f"ET.Rx({alpha!r})", f"ET.Ry({beta!r})"]
            body.append(f"    {'* ' if i else ''}{' * '.join(steps)}")
        body += [")", f"robot = ERobot(steps, name={model.name!r})"]
    else:
        body = ["from roboticstoolbox import DHRobot, RevoluteDH", "", "robot = DHRobot(", "    ["]
        for i, joint in enumerate(model.joints):
            a, alpha, d, offset, _ = _si(joint)
            limits = _limits(model, i)
            body.append(
                f"        RevoluteDH(d={d!r}, a={a!r}, alpha={alpha!r}, offset={offset!r}"
                f"{', ' + limits if limits else ''}),"
            )
        body += ["    ],", f"    name={model.name!r},", ")"]
    return "\n".join([*head, *body, ""])


def write_yaml(model: Model) -> str:
    """Return the parameters with uncertainties, nominal values, validation and the hashes of their inputs."""
    import yaml

    document = {
        "robot": model.name,
        **{
            name: model.document[name]
            for name in (
                *(
                    "convention",
                    "joint_coupling",
                    "method",
                    "source",
                    "estimator",
                    "named_sweeps",
                    "session_id",
                    "inputs_sha256",
                ),
                *(
                    "core_version",
                    "residual",
                    "chain_residual",
                    "validation",
                    "condition_number",
                    "null_space",
                ),
                *("model", "error_model", "region", "method_agreement"),
            )
        },
        "joints": [
            {
                "name": model.joint_names[i],
                **joint,
                "limits_deg": list(limits) if limits is not None else None,
            }
            for i, (joint, limits) in enumerate(zip(model.joints, model.limits_deg, strict=True))
        ],
        **{name: model.document[name] for name in _FRAMES if name in model.document},
    }
    text: str = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=120)
    return text


def write_csv(model: Model) -> str:
    """Return one row per joint; unknown values are empty."""
    text = io.StringIO()
    rows = csv.DictWriter(text, CSV_COLUMNS, lineterminator="\n")
    rows.writeheader()
    for name, joint in zip(model.joint_names, model.joints, strict=True):
        nominal = joint["nominal"] or {}
        rows.writerow(
            {
                "joint": joint["joint"],
                "name": name,
                **{p: joint[p] for p in DH_PARAMETERS},
                **{f"u_{p}": joint["standard_uncertainty"][p] for p in DH_PARAMETERS},
                **{f"nominal_{p}": nominal.get(p) for p in DH_PARAMETERS[:4]},
                **{f"identifiable_{p}": _truth(joint["identifiable"][p]) for p in DH_PARAMETERS},
                "parallel_to_next": _truth(joint["parallel_to_next"]),
            }
        )
    return text.getvalue()


def _truth(value: bool) -> str:
    return "true" if value else "false"


WRITERS: dict[str, Callable[[Model], str]] = {
    "urdf": write_urdf,
    "roboticstoolbox": write_roboticstoolbox,
    "yaml": write_yaml,
    "csv": write_csv,
}


def _unused_name(name: str, others: Sequence[str | None]) -> str:
    while name in others:
        name += "_"
    return name


def _provenance(model: Model) -> list[str]:
    document = model.document
    alone, whole = document["chain_residual"], document["residual"]
    residual = (alone or whole)["position_rms_mm"]
    beyond = [
        f"with base and tool fitted to it; with the terms beyond the chain, which this file does not hold, "
        f"{whole['position_rms_mm']:.4g} mm; the best chain by itself is that of model dh"
    ]
    return [
        f"Identified by Gridpose {document['core_version']}, method {document['method']}, from "
        f"{document['source'].replace('_', ' ')} of session {document['session_id']}",
        f"inputs_sha256 {document['inputs_sha256']}; rms residual {residual:.4g} mm",
        *(beyond if alone else ()),
        "Unidentifiable parameters have their nominal value or zero: theta and d of the first joint, all of the last.",
    ]


def _radians(degrees: float | None) -> float:
    return math.radians(degrees or 0.0)


def _si(joint: Json) -> tuple[float, float, float, float, float]:
    """Return a, α, d, offset, β in m and rad."""
    alpha, offset, beta = (_radians(joint[name]) for name in ("alpha_deg", "theta_offset_deg", "beta_deg"))
    return joint["a_mm"] / 1000.0, alpha, joint["d_mm"] / 1000.0, offset, beta


def _limits(model: Model, i: int) -> str:
    limits = model.limits_deg[i]
    if limits is None:
        return ""
    low, high = map(math.radians, limits)
    return f"qlim=[{low!r}, {high!r}]"


def _joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    T: Float[np.ndarray, "4 4"],
    rule: str,
    *,
    axis: bool = True,
) -> list[str]:
    roll, pitch, yaw = rotation_to_rpy(T[:3, :3]).tolist()
    x, y, z = T[:3, 3].tolist()
    lines = [
        f'  <joint name={quoted_attribute(name)} type="{kind}">',
        f'    <origin xyz="{x!r} {y!r} {z!r}" rpy="{roll!r} {pitch!r} {yaw!r}"/>',
        f'    <parent link="{parent}"/>',
        f'    <child link="{child}"/>',
    ]
    if axis:
        lines.append('    <axis xyz="0 0 1"/>')
    if rule:
        lines.append(f"    {rule}")
    return [*lines, "  </joint>"]


def _link(joint: Json) -> Float[np.ndarray, "4 4"]:
    """Return Tz(d) Tx(a) Rx(α) Ry(β), translation in metres."""
    a, alpha, d, _, beta = _si(joint)
    return link_transform(a, alpha, d, beta)


def _metres(T_mm: Sequence[Sequence[float]]) -> Float[np.ndarray, "4 4"]:
    T = np.array(T_mm)
    T[:3, 3] /= 1000.0
    return T
