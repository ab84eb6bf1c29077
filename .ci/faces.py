#!/usr/bin/env python3
"""Check that a package with a face is imported from its face only, as CONTRIBUTING.md says.

A face is an `__init__.py` with an `__all__`. Modules within the package import each other; everything else, and be it
for annotations or inside a function, imports the package. Prints each other import, and exits with 1 if there is one.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OPEN = {"core", "app.blobs", "app.services.inspection"}
"""Packages whose modules are imported from elsewhere, too: their face has what most need."""
ENTRIES = {"app.client.commands"}
"""Packages with a face of their own that are no part of the one above them."""


def modules() -> dict[str, tuple[Path, ast.Module]]:
    """Return path and tree of each module of app and core, by dotted name."""
    found = {}
    for root in ("app", "core"):
        for path in sorted((ROOT / root).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            found[name] = path, ast.parse(path.read_text(encoding="utf-8"))
    return found


def face(tree: ast.Module) -> set[str] | None:
    """Return the names in the `__all__` of a module, or None where it has none."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return {name.value for name in ast.walk(node.value) if isinstance(name, ast.Constant)}
    return None


def imports(name: str, path: Path, tree: ast.Module) -> Iterator[tuple[int, str, str]]:
    """Yield line, module and name of each import: of `import a.b`, ("a.b", "")."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
            above = base[: len(base) - node.level + 1] if node.level else []
            module = ".".join([*above, node.module] if node.module else above)
            yield from ((node.lineno, module, alias.name) for alias in node.names)


def main() -> int:
    known = modules()
    faces = {
        name: names
        for name, (path, tree) in known.items()
        if path.name == "__init__.py" and (names := face(tree)) is not None
    }
    found = []
    for importer, (path, tree) in known.items():
        for line, module, name in imports(importer, path, tree):
            # A face may have a function named as its module is: then the function is what is imported.
            inner = f"{module}.{name}" in known and name not in faces.get(module, ())
            parts = (f"{module}.{name}" if inner else module).split(".")
            for depth in range(1, len(parts)):
                package, child = ".".join(parts[:depth]), ".".join(parts[: depth + 1])
                within = f"{importer}.".startswith(f"{package}.")
                if package in faces and not within and package not in OPEN and child not in ENTRIES:
                    found.append(f"{path.relative_to(ROOT)}:{line}: {'.'.join(parts)} -> {package}")
    if found:
        print("packages are imported from their face:", *found, sep="\n  ")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
