"""Examples of request and response bodies: `examples.json`, which `make examples` records from a real run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from app.api.problems import MEDIA_TYPE

EXAMPLES_PATH = Path(__file__).with_name("examples.json")


def add_examples(document: dict[str, Any]) -> None:
    """Put the recorded example of each body into the document; a body that was not recorded stays without one.

    Problems that were not recorded refer to one example of each status in `components`. A request's is in its schema:
    openapi-generator warns of examples of objects anywhere else.
    """
    recorded = json.loads(EXAMPLES_PATH.read_text(encoding="utf-8"))
    shared = document["components"]["examples"] = {}
    for status, problem in recorded["problems"].items():
        shared[f"problem_{status}"] = {"summary": problem["title"], "value": problem}
    for path in document["paths"].values():
        for operation in path.values():
            of_operation = recorded["operations"].get(
                operation["operationId"], {"request": {}, "responses": {}}
            )
            for media_type, content in operation.get("requestBody", {}).get("content", {}).items():
                if media_type in of_operation["request"]:
                    content["schema"]["examples"] = [of_operation["request"][media_type]]
            for status, response in operation["responses"].items():
                for media_type, content in response.get("content", {}).items():
                    if media_type in of_operation["responses"].get(status, {}):
                        content["example"] = of_operation["responses"][status][media_type]
                    elif media_type == MEDIA_TYPE and f"problem_{status}" in shared:
                        reference = {"$ref": f"#/components/examples/problem_{status}"}
                        content["examples"] = {"recorded": reference}
