"""Exit codes of what cannot be used: nothing listens where these commands would send to."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from app.cli.main import app


@pytest.mark.parametrize(
    "url", ["127.0.0.1:9", "measuring-pc", "ftp://127.0.0.1:9", "http://", "http://127.0.0.1:90000"]
)
def test_an_address_that_is_none_is_an_unusable_option(url: str) -> None:
    for command in (["sessions", "list"], ["login"], ["robots", "history", "arm"]):
        ended = CliRunner().invoke(app, command, env={"GRIDPOSE_URL": url, "GRIDPOSE_KEY": "gp_a_b"})
        assert ended.exit_code == 2, ended.output
