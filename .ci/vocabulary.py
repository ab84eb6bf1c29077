#!/usr/bin/env python3
"""Check that names, docstrings, comments, messages, documents and paths use the field's words.

`.ci/vocabulary.toml` lists each rejected word with the one to use, the few names that keep one, and retired names.
Prints each place as `path:line: word -> use`, and exits with 1 if there is one.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SETTINGS = tomllib.loads((ROOT / ".ci" / "vocabulary.toml").read_text(encoding="utf-8"))
ALLOWED_NAMES = frozenset(SETTINGS["allowed"]["names"])
PATTERNS = [
    (re.compile(rf"(?<![A-Za-z])(?:{entry['word']})(?![A-Za-z])", re.IGNORECASE), entry)
    for entry in SETTINGS["rejected"]
]
RETIRED_NAMES = frozenset(SETTINGS["retired"]["names"])
_TOKEN = re.compile(r"[A-Za-z_][A-Za-z0-9_.]*")
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")


def files(section: str) -> Iterator[str]:
    """Yield the tracked files that a section of the settings names."""
    listed = subprocess.run(
        ["git", "ls-files", "--", *SETTINGS[section]["paths"]],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    excluded = tuple(SETTINGS[section]["excluded"])
    for path in listed.stdout.splitlines():
        if path.endswith((".py", ".md")) and not path.startswith(excluded) and (ROOT / path).exists():
            yield path


def words_of(line: str) -> str:
    """Return the line with allowed names removed and compound names split into their words."""
    kept = _TOKEN.sub(lambda token: "" if token[0].strip(".") in ALLOWED_NAMES else token[0], line)
    return _CAMEL.sub(" ", kept).replace("_", " ")


def findings(path: str, text: str) -> Iterator[str]:
    """Yield a message for each rejected word of a file; line 0 is its path."""
    for number, line in enumerate((path, *text.splitlines())):
        words = words_of(line)
        for pattern, entry in PATTERNS:
            if path.startswith(tuple(entry.get("allowed_in", ()))):
                continue
            for match in pattern.finditer(words):
                yield f"{path}:{number}: {match[0]} -> {entry['use']}"


def retired(path: str, text: str) -> Iterator[str]:
    """Yield a message for each retired name of a file."""
    for number, line in enumerate(text.splitlines(), start=1):
        for token in re.findall(r"[A-Za-z_][A-Za-z0-9_]*", line):
            if token in RETIRED_NAMES:
                yield f"{path}:{number}: {token} is retired"


def main() -> int:
    """Check every file; return the exit code."""
    found = [
        message
        for section, check in (("checked", findings), ("retired", retired))
        for path in files(section)
        for message in check(path, (ROOT / path).read_text(encoding="utf-8"))
    ]
    print(*found, sep="\n", end="\n" if found else "")
    print(f"vocabulary: {len(found)} rejected words" if found else "vocabulary: ok")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
