"""Texts that the sources may show: every string of a module that is no docstring, with what is filled in as a mark."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

PROJECT = Path(__file__).parents[2]
FILLED_IN = "…"


def modules(*packages: str) -> Iterator[Path]:
    """Every module of these packages, in order."""
    for package in packages:
        yield from sorted((PROJECT / package).rglob("*.py"))


def texts_of(node: ast.AST) -> Iterator[str]:
    """Every string below a node, those of a formatted string as one."""
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return  # a docstring, or one of a constant
    if isinstance(node, ast.JoinedStr):
        yield "".join(
            str(part.value) if isinstance(part, ast.Constant) else FILLED_IN for part in node.values
        )
        for part in node.values:
            if not isinstance(part, ast.Constant):
                yield from texts_of(part)
    elif isinstance(node, ast.Constant):
        if isinstance(node.value, str):
            yield node.value
    else:
        for child in ast.iter_child_nodes(node):
            yield from texts_of(child)
