"""Units, alert rules and the operations manual name what there is."""

from __future__ import annotations

import configparser
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from app.analyses.service import AnalysisService
from app.api.metrics import Metrics
from app.cli.demo.service_process import STOP_WITHIN_S
from app.services.installation.context import ServiceContext
from app.settings import Settings

PROJECT = Path(__file__).parents[2]
UNITS = ("gridpose.service", "gridpose-worker.service")
_EXPOSURE = re.compile(r"Overall exposure level for \S+: ([\d.]+)")
# A metric's name in an expression; labels and functions are not in it.
_METRIC = re.compile(r"\bgridpose_\w+")


def unit(name: str) -> dict[str, str]:
    """The [Service] section; of a key given several times, the last value."""
    parser = configparser.ConfigParser(strict=False, interpolation=None, delimiters=("=",))
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read(PROJECT / "docker" / name, encoding="utf-8")
    assert parser["Install"]["WantedBy"] == "multi-user.target"
    return dict(parser["Service"])


@pytest.mark.parametrize("name", UNITS)
def test_a_unit_is_watched_restarted_and_given_time_to_end(name: str) -> None:
    service = unit(name)
    assert (service["Type"], service["Restart"], service["KillMode"]) == ("notify", "always", "mixed")
    assert int(service["WatchdogSec"]) == 30
    assert int(service["TimeoutStopSec"]) > STOP_WITHIN_S
    assert service["UMask"] == "0077"
    # Kernels that were not compiled beforehand are compiled in memory.
    assert "MemoryDenyWriteExecute" not in service


def test_the_worker_computes_where_the_service_is_set_not_to() -> None:
    """Both read /etc/gridpose.env, which has GRIDPOSE_WORKERS=0; what a file sets, `Environment=` does not change."""
    worker = unit("gridpose-worker.service")
    assert worker["EnvironmentFile"] == unit("gridpose.service")["EnvironmentFile"]
    assert worker["UnsetEnvironment"] == "GRIDPOSE_WORKERS"


@pytest.mark.parametrize("name", UNITS)
def test_systemd_accepts_the_units(name: str, tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd is not installed")
    program = tmp_path / "gridpose"
    program.write_text("#!/bin/sh\n", encoding="utf-8")
    program.chmod(0o755)
    text = (PROJECT / "docker" / name).read_text(encoding="utf-8")
    assert "/opt/gridpose/.venv/bin/gridpose" in text
    copy = tmp_path / name
    copy.write_text(text.replace("/opt/gridpose/.venv/bin/gridpose", str(program)), encoding="utf-8")
    verified = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(copy)], capture_output=True, text=True, check=False
    )
    ours = [line for line in (verified.stdout + verified.stderr).splitlines() if name in line]
    assert (verified.returncode, ours) == (0, [])
    rated = subprocess.run(
        ["systemd-analyze", "security", "--offline=yes", str(copy)],
        capture_output=True,
        text=True,
        check=False,
    )
    exposure = _EXPOSURE.search(rated.stdout)
    assert exposure is not None, rated.stderr
    assert float(exposure[1]) < 2.0, "as docs/operations.md says"


@pytest.fixture
def alerts() -> list[dict[str, Any]]:
    loaded = yaml.safe_load((PROJECT / "docker" / "alerts.yml").read_text(encoding="utf-8"))
    return [rule for group in loaded["groups"] for rule in group["rules"]]


def test_every_metric_of_an_alert_exists(alerts: list[dict[str, Any]], tmp_path: Path) -> None:
    installation = ServiceContext.open(Settings(data_dir=tmp_path, workers=1))
    metrics, analyses = Metrics(), AnalysisService(installation.settings, installation.database)
    try:
        metrics.watch(installation, installation.runner(), analyses)
        metrics.request_done("PUT", "/v1/x", 202, 0.1)
        text = metrics.render().decode()
    finally:
        analyses.close()
        installation.close()
    there = set(re.findall(r"^(\w+)[ {]", text, re.MULTILINE))
    named = {name for rule in alerts for name in _METRIC.findall(rule["expr"])}
    assert named <= there, named - there
    assert len(named) >= 6


def test_every_alert_says_what_to_do(alerts: list[dict[str, Any]]) -> None:
    for rule in alerts:
        assert rule["labels"]["severity"] in ("page", "ticket")
        assert {"summary", "action"} <= set(rule["annotations"]), rule["alert"]
        for setting in re.findall(r"GRIDPOSE_(\w+)", rule["annotations"]["action"]):
            assert setting.lower() in Settings.model_fields, setting


@pytest.mark.parametrize("document", ["backup.md", "errors.md", "operations.md", "security.md"])
def test_the_manual_names_files_and_settings_that_exist(document: str) -> None:
    text = (PROJECT / "docs" / document).read_text(encoding="utf-8")
    named = [PROJECT / path for path in re.findall(r"`((?:docker|tests|docs)/[\w./-]+)`", text)]
    named += [PROJECT / "docs" / path for path in re.findall(r"\]\((?!http|#)([\w./-]+)", text)]
    assert [path for path in named if not path.exists()] == []
    others = {"MEMORY", "PUBLISH", "URL", "KEY", "KEY_FILE"}  # of docker/compose.yaml and of the client
    settings = set(re.findall(r"GRIDPOSE_(\w+)", text)) - others
    assert {setting.lower() for setting in settings} <= set(Settings.model_fields)
    assert named or settings


def test_logrotate_accepts_the_rules(tmp_path: Path) -> None:
    if shutil.which("logrotate") is None:
        pytest.skip("logrotate is not installed")
    rules = tmp_path / "rules"
    text = (PROJECT / "docker" / "logrotate.conf").read_text(encoding="utf-8")
    rules.write_text(text.replace("/var/log/gridpose", str(tmp_path)), encoding="utf-8")
    rules.chmod(0o644)
    log = tmp_path / "service.log"
    log.write_text("line\n" * 100, encoding="utf-8")
    rotated = subprocess.run(
        ["logrotate", "--force", "--state", str(tmp_path / "state"), str(rules)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert rotated.returncode == 0, rotated.stderr
    assert log.stat().st_size == 0, "emptied in place"
    assert (tmp_path / "service.log.1").stat().st_size == 500


@pytest.mark.parametrize("name", ["gridpose-watch.service", "gridpose-watch.ps1"])
def test_the_watching_files_give_options_that_exist(name: str) -> None:
    text = (PROJECT / "docker" / name).read_text(encoding="utf-8")
    declared = (PROJECT / "app" / "client" / "commands" / "images" / "watch.py").read_text(encoding="utf-8")
    (command,) = re.findall(r"watch (?:%h|`\")\S* (--.*)", text)
    options = re.findall(r"--([a-z-]+)", command)
    assert {"session", "state-file"} <= set(options)
    assert all(
        option == "url" or re.search(rf"\b{option.replace('-', '_')}:", declared) for option in options
    )


def test_the_scheduled_task_may_run_for_months_and_reach_the_network() -> None:
    """The limits are those of the Task Scheduler's schema; there is no PowerShell to register it with."""
    text = (PROJECT / "docker" / "gridpose-watch.ps1").read_text(encoding="utf-8")
    commands = "\n".join(line.partition("#")[0] for line in text.splitlines())
    assert "-ExecutionTimeLimit ([TimeSpan]::Zero)" in commands, "three days, otherwise"
    assert "-RepetitionInterval" in commands
    assert "-MultipleInstances IgnoreNew" in commands
    assert "S4U" not in commands
    assert "-RestartCount" not in commands
    assert {name for name in re.findall(r"\$(\w+)", commands) if name not in ("env", "HOME")} <= {
        *re.findall(r"^\$(\w+) = ", commands, re.MULTILINE)
    }
    assert all(not line.endswith("` ") for line in text.splitlines()), (
        "a continued line ends with the backtick"
    )


def test_systemd_accepts_the_watching_unit(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd is not installed")
    copy = tmp_path / "gridpose-watch.service"
    text = (PROJECT / "docker" / copy.name).read_text(encoding="utf-8")
    copy.write_text(text.replace("%h/gridpose/bin/gridpose", "/bin/true"), encoding="utf-8")
    ended = subprocess.run(
        ["systemd-analyze", "verify", "--user", "--man=no", str(copy)],
        capture_output=True,
        text=True,
        check=False,
    )
    ours = [line for line in (ended.stdout + ended.stderr).splitlines() if copy.name in line]
    assert ours == []
