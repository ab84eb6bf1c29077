#!/usr/bin/env python3
"""Check that modules have at most 300 lines and folders at most 13 files, as CONTRIBUTING.md says.

Prints each module and folder beyond that, and exits with 1 if there is one.
"""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CODE = ("app", "core", "benchmarks", "tests")
MAX_LINES, MAX_FILES = 300, 13


def main() -> int:
    listed = subprocess.run(
        ["git", "ls-files", "--", *CODE], cwd=ROOT, check=True, capture_output=True, text=True
    )
    paths = [Path(line) for line in listed.stdout.splitlines() if (ROOT / line).exists()]
    files = Counter(path.parent for path in paths)
    found = [f"{folder}: {count} files" for folder, count in files.items() if count > MAX_FILES]
    for path in paths:
        if path.suffix == ".py":
            lines = (ROOT / path).read_text(encoding="utf-8").count("\n")
            if lines > MAX_LINES:
                found.append(f"{path}: {lines} lines")
    if found:
        print(f"at most {MAX_LINES} lines in a module, {MAX_FILES} files in a folder:", *found, sep="\n  ")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
