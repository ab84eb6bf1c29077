"""Parameters that are not identifiable: for each group that cannot be determined separately its keys and a sentence."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from core.kinematics.arm_model import ALPHA, BETA, FLANGE_CAMERA, THETA, A, D, ParameterLayout


@dataclass(frozen=True, slots=True)
class FixedParameters:
    """Columns held, and for each the null vector in which it is 1 and the other held ones 0."""

    columns: list[int]
    vectors: list[dict[int, float]]


@dataclass(frozen=True, slots=True)
class Unidentifiable:
    """Parameters that the poses do not determine separately, and the sentence that says so.

    `parameters` are keys of `ParameterLayout.keys`; a frame that takes part as a whole is named by its key alone.
    """

    parameters: tuple[str, ...]
    sentence: str


def unidentifiable(
    held: FixedParameters, layout: ParameterLayout, parallel: Bool[np.ndarray, " j"], positions_only: bool
) -> Iterator[Unidentifiable]:
    """Yield each group of parameters that cannot be determined separately."""
    names, keys = layout.names(), layout.keys()
    groups: list[tuple[list[int], set[int]]] = []  # columns held, and the other columns that take part
    for column, vector in zip(held.columns, held.vectors, strict=True):
        partners = {_kind(c, layout) for c in vector if c != column}
        for group in groups:
            joined = {p for p in partners & group[1] if p >= 0}
            if joined or partners == group[1]:
                group[0].append(column)
                group[1].update(partners)
                break
        else:
            groups.append(([column], partners))
    for columns, partners in groups:
        own = [names[c] for c in columns]
        others = sorted(p for p in partners if p >= 0)
        frames = [word for kind, word in ((_TOOL, "tool"), (_BASE, "base")) if kind in partners]
        of_frames = " and ".join(f"the {word} transform" for word in frames)
        if frames == ["base"] and layout.targets > 1:
            of_frames = "the base transforms"
        if others and not frames:
            everything = sorted([*columns, *others])
            because = _because(everything, parallel)
            sentence = f"{_listed([names[c] for c in everything])} cannot be determined separately{because}."
        elif others:
            with_others = _listed([names[c] for c in others])
            sentence = f"{_listed(own)} cannot be separated from {with_others} and {of_frames}."
        elif frames:
            sentence = f"{_listed(own)} cannot be separated from {of_frames}."
        elif positions_only and all(c in range(layout.tool.start + 3, layout.tool.stop) for c in columns):
            sentence = "The tool's orientation cannot be determined: the poses are positions alone."
        else:
            which = "it" if len(own) == 1 else "them"
            sentence = f"{_listed(own)} cannot be determined: no pose depends on {which}."
        yield Unidentifiable(
            (*(keys[c] for c in sorted([*columns, *others])), *_frame_keys(partners, layout)), sentence
        )


def _frame_keys(partners: set[int], layout: ParameterLayout) -> Iterator[str]:
    """Yield the keys of the frames that take part as a whole."""
    if _TOOL in partners:
        yield FLANGE_CAMERA
    if _BASE in partners:
        yield from (layout.base_key(target) for target in range(layout.targets))


def held_by_axes(
    identifiable: Bool[np.ndarray, "j 5"],
    parallel: Bool[np.ndarray, " j"],
    coincident: Bool[np.ndarray, " j"],
) -> FixedParameters:
    """Return what parameters read off axes leave open; `parallel` and `coincident` are of each axis and the next.

    The first joint's θ and d are the base's, all of the last joint the tool's. Along a run of parallel axes d can be
    given to any of the joints, about axes that are one line θ; where the run begins at the first joint or ends at the
    last, to the base or to the tool.
    """
    joints = len(identifiable)
    layout = ParameterLayout(joints, 1, 0)
    held = FixedParameters([], [])
    joints_in_order = dict.fromkeys([0, joints - 1, *range(joints)])
    for joint, parameter in itertools.product(joints_in_order, (THETA, D, A, ALPHA, BETA)):
        # β is no parameter of a link between axes that are not parallel.
        if identifiable[joint, parameter] or (parameter == BETA and not parallel[joint]):
            continue
        run = {D: parallel, THETA: coincident}.get(parameter)
        end = joint
        while run is not None and end < joints - 1 and run[end]:
            end += 1
        if end == joints - 1:
            partner = layout.tool.start
        elif joint == 0 or (run is not None and run[:joint].all()):
            partner = layout.base(0).start
        else:
            partner = layout.column(end, parameter)
        column = layout.column(joint, parameter)
        held.columns.append(column)
        held.vectors.append({column: 1.0, partner: -1.0})
    return held


_TOOL, _BASE = -1, -2


def _kind(column: int, layout: ParameterLayout) -> int:
    """Return the column of a joint's parameter, or which frame another belongs to."""
    if layout.joint_of(column) is not None:
        return column
    return _TOOL if column < layout.tool.stop else _BASE


def _because(columns: Sequence[int], parallel: Bool[np.ndarray, " j"]) -> str:
    joints = sorted({c // 5 for c in columns})
    consecutive = joints == list(range(joints[0], joints[-1] + 1))
    if consecutive and all(c % 5 == D for c in columns) and parallel[joints[:-1]].all():
        return f": joints {_listed([str(i + 1) for i in joints])} are parallel"
    if consecutive and len(joints) == 2 and all(c % 5 in (D, THETA) for c in columns):
        return f": the axes of joints {_listed([str(i + 1) for i in joints])} coincide"
    return ""


def weakly_identifiable(held: FixedParameters, layout: ParameterLayout) -> Iterator[Unidentifiable]:
    """Yield each parameter that is held because the poses hardly determine it, with those it resembles most."""
    names, keys = layout.names(), layout.keys()
    for column, vector in zip(held.columns, held.vectors, strict=True):
        strongest = sorted((c for c in vector if c != column), key=lambda c: -abs(vector[c]))[:3]
        sentence = f"{names[column]} can hardly be determined at these poses; it is held."
        if strongest:
            sentence = (
                f"{names[column]} can hardly be separated from {_listed([names[c] for c in strongest])} at these "
                "poses; it is held."
            )
        yield Unidentifiable(tuple(keys[c] for c in (column, *strongest)), sentence)


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]
