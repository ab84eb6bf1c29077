"""The container is set up by the very steps of a developer's machine, and says when it is well."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from app.cli.demo.service_process import STOP_WITHIN_S
from app.settings import Settings

PROJECT = Path(__file__).parents[2]


@pytest.fixture
def dockerfile() -> list[tuple[str, str]]:
    """The Dockerfile's instructions with their arguments, continued lines joined."""
    text = (PROJECT / "docker" / "Dockerfile").read_text(encoding="utf-8").replace("\\\n", " ")
    lines = [line.split(" ", 1) for line in text.splitlines() if line and not line.startswith("#")]
    return [(instruction, rest) for instruction, rest in lines]


@pytest.fixture
def compose() -> dict[str, Any]:
    loaded: dict[str, Any] = yaml.safe_load((PROJECT / "docker" / "compose.yaml").read_text(encoding="utf-8"))
    return loaded


def test_the_image_is_set_up_by_make_setup_and_nothing_else(dockerfile: list[tuple[str, str]]) -> None:
    runs = [rest for instruction, rest in dockerfile if instruction == "RUN"]
    setups = [run for run in runs if "make setup" in run]
    assert len(setups) == 1
    assert not any(
        re.search(r"\b(pip|uv|conda|poetry)\b(?!,)", re.sub(r"--mount=\S+", "", run)) for run in runs
    )


def test_what_make_setup_needs_reaches_the_image() -> None:
    ignore = (PROJECT / "docker" / "Dockerfile.dockerignore").read_text(encoding="utf-8").splitlines()
    let_in = {line[1:] for line in ignore if line.startswith("!")}
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
    packages = project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    assert let_in == {
        "Makefile",
        "pyproject.toml",
        "requirements.txt",
        project["project"]["readme"],
        *packages,
    }
    assert all((PROJECT / name).exists() for name in let_in)


def test_it_runs_the_service_without_privileges_and_keeps_its_data(dockerfile: list[tuple[str, str]]) -> None:
    last_stage = dockerfile[max(i for i, (name, _) in enumerate(dockerfile) if name == "FROM") :]
    instructions = dict(last_stage)
    assert instructions["USER"] == "gridpose"
    assert instructions["CMD"] == '["gridpose", "serve"]'
    assert "/readyz" in instructions["HEALTHCHECK"]
    variables = dict(re.findall(r"(GRIDPOSE_\w+)=(\S+)", instructions["ENV"]))
    assert variables["GRIDPOSE_DATA_DIR"] == instructions["VOLUME"] == "/data"
    assert variables["GRIDPOSE_PORT"] == instructions["EXPOSE"] == "8000"
    assert {name.removeprefix("GRIDPOSE_").lower() for name in variables} <= set(Settings.model_fields)


def test_compose_waits_for_an_orderly_end_and_names_real_settings(compose: dict[str, Any]) -> None:
    (service,) = compose["services"].values()
    assert float(service["stop_grace_period"].removesuffix("s")) > STOP_WITHIN_S
    assert {name.removeprefix("GRIDPOSE_").lower() for name in service["environment"]} <= set(
        Settings.model_fields
    )
    build = service["build"]
    assert (
        PROJECT / "docker" / build["context"] / build["dockerfile"]
    ).resolve() == PROJECT / "docker" / "Dockerfile"
    (volume,) = service["volumes"]
    assert volume.split(":") == [next(iter(compose["volumes"])), "/data"]
