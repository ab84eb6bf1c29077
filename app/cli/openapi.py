"""`python -m app.cli.openapi [--check]`: write openapi.json from the code, or fail where it has drifted."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from app.main import create_app
from app.settings import Settings

PATH = Path(__file__).parents[2] / "openapi.json"


def openapi_text() -> str:
    """Return the contract as committed: the same on every machine, whatever its environment says."""
    settings = Settings.model_construct(data_dir=Path("gridpose-data"))
    return json.dumps(create_app(settings).openapi(), indent=2, ensure_ascii=False) + "\n"


def main() -> int:
    text = openapi_text()
    if "--check" not in sys.argv[1:]:
        PATH.write_text(text, encoding="utf-8")
        return 0
    if not PATH.exists() or PATH.read_text(encoding="utf-8") != text:
        print(
            "openapi.json is not what the code says: run `make openapi` and read the difference.",
            file=sys.stderr,
        )
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
