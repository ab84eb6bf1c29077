"""An identified robot as files that others read: URDF, a Robotics Toolbox model, YAML, CSV.

All have the same forward kinematics, T_{i-1,i} = Rz(θ_i + offset_i) Tz(d_i) Tx(a_i) Rx(α_i) Ry(β_i), with every digit a
double has. URDF and the toolbox count in metres and radians.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

from app.agent import Json

PARAMETERS = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg", "beta_deg")
CSV_COLUMNS = (
    "joint",
    "name",
    *PARAMETERS,
    *(f"u_{name}" for name in PARAMETERS),
    *(f"nominal_{name}" for name in PARAMETERS[:4]),
    *(f"identifiable_{name}" for name in PARAMETERS),
    "parallel_to_next",
)


@dataclass(frozen=True, slots=True)
class Model:
    """The answer of `GET .../dh`, with what the robot's maker says beside it: names and limits (deg) of joints, None of
    those that turn freely.
    """

    document: Json
    name: str
    joint_names: tuple[str, ...]
    limits_deg: tuple[tuple[float, float] | None, ...]
    with_camera: bool

    @property
    def joints(self) -> Sequence[Json]:
        joints: Sequence[Json] = self.document["joints"]
        return joints


def write_urdf(model: Model) -> str:
    """Return a URDF: links base_link, link_1 ..., flange, and camera where it is asked for and known.

    A URDF's joint is a fixed transform, then a turn: each joint's holds what follows the turn before it.
    """
    lines = ['<?xml version="1.0" encoding="utf-8"?>', f"<robot name={quoteattr(model.name)}>"]
    lines += [f"  <!-- {escape(line).replace('--', '- -')} -->" for line in _provenance(model)]
    count = len(model.joints)
    names = ["base_link", *(f"link_{i}" for i in range(1, count + 1)), "flange"]
    fixed = _product()
    for i, joint in enumerate(model.joints):
        origin = _times(fixed, _rotation_z(_radians(joint["theta_offset_deg"])))
        kind, limit, limits = "continuous", "", model.limits_deg[i]
        if limits is not None:
            low, high = map(math.radians, limits)
            kind = "revolute"
            limit = f'<limit lower="{low!r}" upper="{high!r}" effort="0" velocity="0"/>'
        lines += _joint(model.joint_names[i], kind, names[i], names[i + 1], origin, limit)
        fixed = _link(joint)
    lines += _joint("flange_joint", "fixed", names[count], "flange", fixed, "", axis=False)
    camera = model.document.get("T_flange_camera") if model.with_camera else None
    if camera is not None:
        names.append("camera")
        lines += _joint("camera_joint", "fixed", "flange", "camera", _metres(camera), "", axis=False)
    lines += [f'  <link name="{name}"/>' for name in names]
    return "\n".join([*lines, "</robot>", ""])


def write_rtb(model: Model) -> str:
    """Return Python for Peter Corke's Robotics Toolbox; `robot` is the model.

    Where axes are near parallel β stands beside d, for which DHRobot has no place: the model is then an elementary
    transform sequence.
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
    """Return the parameters with all that is known of them, and of what they were computed from."""
    import yaml

    document = {
        "robot": model.name,
        **{
            name: model.document[name]
            for name in (
                *("convention", "method", "source", "estimator", "sweeps", "session_id", "inputs_sha256"),
                *("core_version", "residual", "validation", "condition_number", "null_space"),
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
        **{name: model.document[name] for name in ("T_flange_camera", "T_target_base")},
    }
    text: str = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=120)
    return text


def write_csv(model: Model) -> str:
    """Return one row a joint; what is not known is empty."""
    text = io.StringIO()
    rows = csv.DictWriter(text, CSV_COLUMNS, lineterminator="\n")
    rows.writeheader()
    for name, joint in zip(model.joint_names, model.joints, strict=True):
        nominal = joint["nominal"] or {}
        rows.writerow(
            {
                "joint": joint["joint"],
                "name": name,
                **{p: joint[p] for p in PARAMETERS},
                **{f"u_{p}": joint["standard_uncertainty"][p] for p in PARAMETERS},
                **{f"nominal_{p}": nominal.get(p) for p in PARAMETERS[:4]},
                **{f"identifiable_{p}": joint["identifiable"][p] for p in PARAMETERS},
                "parallel_to_next": joint["parallel_to_next"],
            }
        )
    return text.getvalue()


WRITERS: dict[str, Callable[[Model], str]] = {
    "urdf": write_urdf,
    "rtb": write_rtb,
    "yaml": write_yaml,
    "csv": write_csv,
}

Matrix = list[list[float]]


def _provenance(model: Model) -> list[str]:
    document = model.document
    residual = document["residual"]["position_rms_mm"]
    return [
        f"Identified by Gridpose {document['core_version']}, method {document['method']}, from "
        f"{document['source'].replace('_', ' ')} of session {document['session_id']}",
        f"inputs_sha256 {document['inputs_sha256']}; rms residual {residual:.4g} mm",
        "What cannot be told has the nominal's value or zero: the first joint's theta and d, the last joint's all.",
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
    name: str, kind: str, parent: str, child: str, T: Matrix, limit: str, *, axis: bool = True
) -> list[str]:
    roll, pitch, yaw = _roll_pitch_yaw(T)
    x, y, z = (T[k][3] for k in range(3))
    lines = [
        f'  <joint name={quoteattr(name)} type="{kind}">',
        f'    <origin xyz="{x!r} {y!r} {z!r}" rpy="{roll!r} {pitch!r} {yaw!r}"/>',
        f'    <parent link="{parent}"/>',
        f'    <child link="{child}"/>',
    ]
    if axis:
        lines.append('    <axis xyz="0 0 1"/>')
    if limit:
        lines.append(f"    {limit}")
    return [*lines, "  </joint>"]


def _link(joint: Json) -> Matrix:
    """Return Tz(d) Tx(a) Rx(α) Ry(β) in metres."""
    a, alpha, d, _, beta = _si(joint)
    ca, sa, cb, sb = math.cos(alpha), math.sin(alpha), math.cos(beta), math.sin(beta)
    return [[cb, 0.0, sb, a], [sa * sb, ca, -sa * cb, 0.0], [-ca * sb, sa, ca * cb, d], [0.0, 0.0, 0.0, 1.0]]


def _rotation_z(angle: float) -> Matrix:
    c, s = math.cos(angle), math.sin(angle)
    return [[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]


def _product() -> Matrix:
    return [[float(i == k) for k in range(4)] for i in range(4)]


def _times(A: Matrix, B: Matrix) -> Matrix:
    return [[sum(A[i][m] * B[m][k] for m in range(4)) for k in range(4)] for i in range(4)]


def _metres(T: Matrix) -> Matrix:
    return [[*row[:3], row[3] / 1000.0] for row in T[:3]] + [T[3]]


def _roll_pitch_yaw(T: Matrix) -> tuple[float, float, float]:
    """Return the angles of R = Rz(yaw) Ry(pitch) Rx(roll), whose product is R to the last digits at ±90° of pitch too.

    There yaw is what rounding makes of it, and roll is read off Rz(-yaw) R, which makes up for it.
    """
    yaw = math.atan2(T[1][0], T[0][0])
    pitch = math.atan2(-T[2][0], math.hypot(T[0][0], T[1][0]))
    c, s = math.cos(yaw), math.sin(yaw)
    roll = math.atan2(s * T[0][2] - c * T[1][2], c * T[1][1] - s * T[0][1])
    return roll, pitch, yaw
