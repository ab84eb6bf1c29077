"""Exit codes of options that cannot be used."""

from __future__ import annotations

from typing import Any

import pytest
from typer.testing import CliRunner

from app.cli.main import app
from tests.support.command_line import gridpose


@pytest.mark.parametrize(
    "url", ["127.0.0.1:9", "measuring-pc", "ftp://127.0.0.1:9", "http://", "http://127.0.0.1:90000"]
)
def test_an_address_that_cannot_be_used_is_a_wrong_option(url: str) -> None:
    for command in (["sessions", "list"], ["login"], ["robots", "history", "arm"]):
        ended = CliRunner().invoke(app, command, env={"GRIDPOSE_URL": url, "GRIDPOSE_KEY": "gp_a_b"})
        assert ended.exit_code == 2, ended.output


@pytest.mark.parametrize("target", ["chessboard:9x6", "sheet:gp-1"])
def test_a_form_that_cannot_be_read_makes_no_target(served: Any, target: str) -> None:
    given = ("--target", "chessboard:31x7:5", "--target", target)
    gridpose(served, "sessions", "create", "forms", *given, code=2)
    gridpose(served, "sessions", "change", served.make_session(), *given, code=2)
    assert all(item["columns"] != 31 for item in served.client.get("/v1/targets").json()["items"])
