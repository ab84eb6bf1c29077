"""Draw the figure of docs/architecture.md: `python docs/figures/draw_architecture.py [--into docs/figures]`.

Rows are the layers that `pyproject.toml` declares and import-linter enforces. Boxes and lines are what the sources
import: a line from a box to a lower one means that the upper package imports the lower one.
"""

from __future__ import annotations

import argparse
import ast
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

PROJECT = Path(__file__).parents[2]
COLOURS = {"core": "#dbe8f6", "app": "#f3e6d3"}
EDGE, TEXT = "#8a8a8a", "#2c2c2c"
BOX_HEIGHT, ROW_HEIGHT = 0.52, 1.0
Place = tuple[float, float]


def layers(root: str) -> list[list[str]]:
    """Return the declared layers of `core` or `app`, top to bottom, each a list of package names."""
    settings = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
    for contract in settings["tool"]["importlinter"]["contracts"]:
        if contract["type"] == "layers" and contract.get("containers") == [root]:
            return [
                [name.strip(" ()") for name in layer.replace(":", "|").split("|")]
                for layer in contract["layers"]
            ]
    raise LookupError(f"pyproject.toml declares no layers for {root}")


def sources(root: str, name: str) -> list[Path]:
    """Return the modules of a package or of a single module."""
    single = PROJECT / root / f"{name}.py"
    return [single] if single.exists() else sorted((PROJECT / root / name).rglob("*.py"))


def imported(path: Path) -> Iterator[str]:
    """Yield the dotted names that a module imports."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def imports(root: str, names: list[str]) -> Counter[tuple[str, str]]:
    """Count the modules of each package that import each other package of the same root."""
    found: Counter[tuple[str, str]] = Counter()
    for name in names:
        for path in sources(root, name):
            targets = {
                parts[1]
                for parts in (full.split(".") for full in imported(path))
                if parts[0] == root and len(parts) > 1
            }
            found.update((name, target) for target in targets & set(names) if target != name)
    return found


def draw_root(axes: Axes, root: str, left: float, width: float, top: float) -> None:
    """Draw one root's layers between `left` and `left + width`, downward from `top`."""
    rows = layers(root)
    places: dict[str, Place] = {}
    widths: dict[str, float] = {}
    for number, names in enumerate(rows):
        share = width / len(names)
        for k, name in enumerate(names):
            places[name] = (left + (k + 0.5) * share, top - number * ROW_HEIGHT)
            widths[name] = min(0.86 * share, 2.6)
    for (upper, lower), count in imports(root, list(places)).items():
        (x0, y0), (x1, y1) = places[upper], places[lower]
        axes.plot(
            [x0, x1],
            [y0 - BOX_HEIGHT / 2, y1 + BOX_HEIGHT / 2],
            color=EDGE,
            lw=min(0.4 + 0.08 * count, 1.8),
            alpha=0.35,
            zorder=1,
        )
    for name, (x, y) in places.items():
        modules = sources(root, name)
        lines = sum(path.read_text(encoding="utf-8").count("\n") for path in modules)
        box = FancyBboxPatch(
            (x - widths[name] / 2, y - BOX_HEIGHT / 2), widths[name], BOX_HEIGHT,
            boxstyle="round,pad=0.02", facecolor=COLOURS[root], edgecolor=EDGE, zorder=2,
        )  # fmt: skip
        axes.add_patch(box)
        axes.text(x, y + 0.08, name, ha="center", va="center", size=9, color=TEXT, zorder=3)
        size = f"{len(modules)} modules, {round(lines, -2):,} lines" if len(modules) > 1 else "1 module"
        axes.text(x, y - 0.14, size, ha="center", va="center", size=5.6, color=TEXT, zorder=3)
    axes.text(left + width / 2, top + 0.62, root, ha="center", size=13, weight="bold", color=TEXT)


def draw(into: Path) -> Path:
    """Write the figure and return its path."""
    height = max(len(layers("core")), len(layers("app")))
    figure = Figure(figsize=(12, 0.62 * height + 0.6), dpi=110)
    axes = figure.add_axes((0.01, 0.01, 0.98, 0.98))
    draw_root(axes, "app", 0.0, 6.6, height)
    draw_root(axes, "core", 7.2, 4.6, height)
    axes.set_xlim(-0.1, 11.9)
    axes.set_ylim(0.3, height + 1)
    axes.set_axis_off()
    path = into / "architecture.png"
    figure.savefig(path)
    return path


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--into", type=Path, default=PROJECT / "docs" / "figures")
    print(draw(arguments.parse_args().into))
