"""The document's examples: one of each body, what its schema says, and what the application answers today."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from app.api.openapi import EXAMPLES_PATH
from app.main import create_app
from app.settings import Settings
from tests.support.contract.contract import JSON_TYPES, TEXT_TYPES, Contract
from tests.support.contract.recording import FORM, keys_of
from tests.support.contract.run import record_examples
from tests.support.environment.side_processes import SideProcesses
from tests.support.service.applications import processes_lent, workers_lent

RENEW = "run `make examples`, then `make openapi`"


@pytest.fixture(scope="module")
def contract() -> Contract:
    return Contract(create_app(Settings(data_dir=Path("/nonexistent/gridpose"))).openapi())


def example_of(contract: Contract, content: dict[str, Any]) -> Any:
    """Return the example of a body, None where it has none."""
    if "examples" in content:
        (reference,) = content["examples"].values()
        return contract.document["components"]["examples"][reference["$ref"].rpartition("/")[2]]["value"]
    in_schema = content["schema"].get("examples", [None])
    return content.get("example", in_schema[0])


def test_every_body_but_images_has_an_example(contract: Contract) -> None:
    missing = [
        f"{operation.operation_id} {place} {media_type}"
        for operation in contract.operations
        for place, media_type, content in operation.bodies()
        if (media_type in (*JSON_TYPES, *TEXT_TYPES, FORM) or media_type.startswith("text/"))
        and example_of(contract, content) is None
    ]
    assert missing == [], RENEW


@pytest.mark.slow
def test_every_example_is_what_its_schema_says(contract: Contract) -> None:
    violations = [
        f"{operation.operation_id} {place}: {violation}"
        for operation in contract.operations
        for place, _, content in operation.bodies()
        if (example := example_of(contract, content)) is not None
        for violation in contract.violations(example, content["schema"])
    ]
    assert violations == [], RENEW


def test_a_body_that_breaks_its_schema_is_noticed(contract: Contract) -> None:
    (create,) = (operation for operation in contract.operations if operation.operation_id == "create_target")
    body = example_of(contract, create.content["requestBody"]["content"]["application/json"])
    schema = create.schema("request")
    assert contract.violations({**body, "columns": 1}, schema)
    assert contract.violations({**body, "kind": "hexagons"}, schema)
    assert contract.violations(
        {**create.content["responses"]["201"]["content"]["application/json"]["example"], "more": 1},
        create.schema("201"),
    )


@pytest.mark.slow
def test_a_run_of_today_gives_the_same_keys(side_processes: SideProcesses, tmp_path: Path) -> None:
    committed = json.loads(EXAMPLES_PATH.read_text(encoding="utf-8"))
    with processes_lent(side_processes), workers_lent(side_processes):
        today = record_examples(tmp_path)
    assert keys_of(today) ^ keys_of(committed) == set(), RENEW
