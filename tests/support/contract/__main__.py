"""`python -m tests.support.contract`: record the examples of the OpenAPI document anew."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

from app.api.openapi import EXAMPLES_PATH
from tests.support.contract.run import record_examples

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        examples = record_examples(Path(folder))
    EXAMPLES_PATH.write_text(json.dumps(examples, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(f"{len(examples['operations'])} operations, {len(examples['problems'])} problems: {EXAMPLES_PATH}")
