"""What poses cannot tell, in words: one sentence for each group of parameters that cannot be told from one another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from core.kinematics.parameters import THETA, D, Layout


@dataclass(frozen=True, slots=True)
class Held:
    """Columns held, and for each the null vector in which it is 1 and the other held ones 0."""

    columns: list[int]
    vectors: list[dict[int, float]]


def sentences(
    held: Held, layout: Layout, parallel: Bool[np.ndarray, " j"], positions_only: bool
) -> Iterator[str]:
    """Say what cannot be told from what, one sentence for each group of parameters that belong together."""
    names = layout.names()
    groups: list[tuple[list[int], set[int]]] = []  # columns held, and what takes part beside them
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
            because = _because(everything, layout, parallel)
            yield f"{_listed([names[c] for c in everything])} cannot be told apart{because}."
        elif others:
            yield f"{_listed(own)} cannot be told from {_listed([names[c] for c in others])} and {of_frames}."
        elif frames:
            yield f"{_listed(own)} cannot be told from {of_frames}."
        elif positions_only and all(c in range(layout.tool.start + 3, layout.tool.stop) for c in columns):
            yield "The tool's orientation cannot be told: the poses are positions alone."
        else:
            yield f"{_listed(own)} cannot be told: no pose depends on {'it' if len(own) == 1 else 'them'}."


_TOOL, _BASE = -1, -2


def _kind(column: int, layout: Layout) -> int:
    """Return the column of a joint's parameter, or which frame another belongs to."""
    if layout.joint_of(column) is not None:
        return column
    return _TOOL if column < layout.tool.stop else _BASE


def _because(columns: Sequence[int], layout: Layout, parallel: Bool[np.ndarray, " j"]) -> str:
    joints = sorted({c // 5 for c in columns})
    consecutive = joints == list(range(joints[0], joints[-1] + 1))
    if consecutive and all(c % 5 == D for c in columns) and parallel[joints[:-1]].all():
        return f": joints {_listed([str(i + 1) for i in joints])} are parallel"
    if consecutive and len(joints) == 2 and all(c % 5 in (D, THETA) for c in columns):
        return f": the axes of joints {_listed([str(i + 1) for i in joints])} coincide"
    return ""


def open_sentences(held: Held, layout: Layout) -> Iterator[str]:
    names = layout.names()
    for column, vector in zip(held.columns, held.vectors, strict=True):
        strongest = sorted((c for c in vector if c != column), key=lambda c: -abs(vector[c]))[:3]
        if strongest:
            yield (
                f"{names[column]} can hardly be told from {_listed([names[c] for c in strongest])} at these poses; "
                "it is held."
            )
        else:
            yield f"{names[column]} can hardly be told at these poses; it is held."


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]
