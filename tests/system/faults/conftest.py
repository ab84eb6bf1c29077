"""The table of faults, and what the trials share."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.system.faults.injections import missing_tool
from tests.system.faults.trial import Account, Results, Trial, undisturbed

_LEDGER = pytest.StashKey[list[Account]]()


@pytest.fixture(scope="session")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """What the images amount to in an undisturbed run of the same build."""
    return undisturbed(tmp_path_factory.mktemp("undisturbed") / "data")


@pytest.fixture
def trial(request: pytest.FixtureRequest, reference: Results) -> Iterator[Trial]:
    """A trial named after its test, entered into the table in any event."""
    name = request.node.name.removeprefix("test_").replace("_", " ")
    account = Account(name)
    yield Trial(account, reference)
    request.config.stash.setdefault(_LEDGER, []).append(account)


@pytest.fixture
def need() -> Callable[[str], None]:
    """Skip where a fault cannot be brought about, unless the build server runs the programme."""

    def check(tool: str) -> None:
        reason = missing_tool(tool)
        if reason is None:
            return
        if os.environ.get("CI") and tool != "mount":
            pytest.fail(f"required here: {reason}")
        pytest.skip(reason)

    return check


@pytest.fixture
def data_dir(tmp_path: Path) -> Path:
    return tmp_path / "data"


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print the table: what was brought about, and what came of the acknowledged uploads."""
    ledger = config.stash.get(_LEDGER, [])
    if not ledger:
        return
    terminalreporter.section("fault programme")
    total = Account("total")
    for field in dataclasses.fields(Account)[1:]:
        setattr(total, field.name, sum(getattr(account, field.name) for account in ledger))
    head = ("injected", "survived", "acknowledged", "lost", "doubled", "changed", "restarts", "seconds")
    terminalreporter.write_line(f"{'fault':58}" + "".join(f"{name:>13}" for name in head))
    for account in [*ledger, total]:
        cells = [getattr(account, name) for name in head]
        terminalreporter.write_line(
            f"{account.fault[:57]:58}"
            + "".join(f"{cell:13.1f}" if isinstance(cell, float) else f"{cell:13d}" for cell in cells)
        )
