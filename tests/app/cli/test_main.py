"""The table of commands: places exist, summaries are those of the commands, nothing is imported before it runs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence

import pytest
from typer.core import TyperGroup
from typer.main import get_command
from typer.testing import CliRunner

from app.cli.main import app
from app.client.commands.lazy import LazyCommand


def lazy_commands() -> Iterator[tuple[str, LazyCommand]]:
    root = get_command(app)
    assert isinstance(root, TyperGroup)
    for name, command in root.commands.items():
        if isinstance(command, LazyCommand):
            yield name, command
        else:
            assert isinstance(command, TyperGroup)
            for second, inner in command.commands.items():
                for third, last in (inner.commands if isinstance(inner, TyperGroup) else {"": inner}).items():
                    assert isinstance(last, LazyCommand)
                    yield f"{name} {second} {third}".rstrip(), last


COMMANDS = dict(lazy_commands())
ROOT = get_command(app)
GROUPS = {
    "": ROOT,
    **{name: group for name, group in vars(ROOT)["commands"].items() if isinstance(group, TyperGroup)},
}
HELP = [*GROUPS, *COMMANDS]
WIDEST = ["", "upload", "watch", "sessions import", "robots create"]
"""Some whose help has long words in narrow columns."""


def test_the_table_holds_every_command() -> None:
    assert sorted(COMMANDS) == sorted(
        [
            *(
                "serve",
                "worker",
                "doctor",
                "qualify",
                "backup",
                "restore",
                "migrate-to",
                "upload",
                "watch",
                "login",
                "logout",
                "demo",
                "version",
            ),
            *("webhooks create", "webhooks list", "webhooks delete", "webhooks test"),
            *("webhooks deliveries", "webhooks redeliver"),
            *("hand-eye export", "camera-poses export", "qualifications list"),
            *("keys create", "keys list", "keys revoke", "schema show", "schema downgrade"),
            *(
                "robots compensate",
                "robots export",
                "robots events add",
                "robots events delete",
                "robots events list",
                "robots plan dh",
                "robots plan iso9283",
                "robots change",
                "measured-poses import",
                "targets print",
                "targets check",
            ),
            *(f"measurements {verb}" for verb in ("list", "show", "correct", "exclude", "include")),
            *("measurements delete", "measurements retry", "measured-poses delete"),
            *(
                f"sessions {verb}"
                for verb in (
                    "list",
                    "show",
                    "budget",
                    "joint-noise",
                    "next-view",
                    "change",
                    "reprocess",
                    "export-camera",
                    "import",
                    "delete",
                )
            ),
            *("sessions archive", "sessions restore", "report compare", "robots history"),
            *(f"report {verb}" for verb in ("create", "list", "show", "fetch", "verify")),
            *(f"targets {verb}" for verb in ("list", "show", "change", "delete")),
            *(f"robots {verb}" for verb in ("list", "show", "delete")),
            *("targets create", "robots create", "sessions create", "poses load"),
        ]
    )


@pytest.mark.parametrize("name", COMMANDS)
def test_a_summary_is_the_first_sentence_of_the_command(name: str) -> None:
    command = COMMANDS[name]
    first, *_ = command.load().help.split("\n\n")
    assert " ".join(first.split()) == command.help


@pytest.mark.parametrize(("command", "text"), [("watch", "[default: by folder]"), ("serve", "127.0.0.1]")])
def test_help_shows_what_is_in_brackets(command: str, text: str) -> None:
    shown = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "200"}).stdout
    assert text in " ".join(shown.replace("│", " ").split())


@pytest.mark.parametrize(("columns", "names"), [(50, HELP), (80, HELP), (130, WIDEST)])
def test_help_cuts_nothing(columns: int, names: Sequence[str]) -> None:
    runner = CliRunner()
    for name in names:
        shown = runner.invoke(app, [*name.split(), "--help"], env={"COLUMNS": str(columns)}).stdout
        assert "…" not in shown, name
        command = COMMANDS[name].load() if name in COMMANDS else GROUPS[name]
        options = {
            option for parameter in command.params for option in parameter.opts if option.startswith("--")
        }
        assert options <= set(re.findall(r"--[\w-]+", shown)), name


def test_the_code_a_command_returns_is_the_exit_code() -> None:
    runner = CliRunner()
    assert runner.invoke(app, ["version"]).exit_code == 0
    assert runner.invoke(app, ["targets", "print", "--kind", "circles"]).exit_code == 2
    assert runner.invoke(app, ["targets", "print", "--nothing"]).exit_code == 2


def test_help_imports_no_command() -> None:
    script = (
        "import sys\n"
        "from typer.testing import CliRunner\n"
        "from app.cli.main import app\n"
        "for arguments in ([], ['keys'], ['targets']):\n"
        "    assert CliRunner().invoke(app, [*arguments, '--help']).exit_code == 0\n"
        "loaded = [m for m in sys.modules if m.startswith(('app.', 'core'))]\n"
        "loaded = [m for m in loaded if m != 'app.client' and not m.startswith(('app.cli.', 'app.client.commands'))]\n"
        "loaded = [m for m in loaded if m not in ('app.cli', 'app.client.lazy_face', 'app.threads')]\n"
        "loaded += [m for m in sys.modules if m.count('.') > 3 or m.startswith('app.cli.') and m.count('.') > 2]\n"
        "loaded += [m for m in ('sqlalchemy', 'fastapi', 'cv2', 'numpy', 'httpx2') if m in sys.modules]\n"
        "sys.exit(', '.join(loaded) or 0)\n"
    )
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr


def test_commands_that_compute_keep_numpy_to_one_thread_but_for_what_the_user_has_set() -> None:
    script = "import app.cli.main, numpy, os; print(len(os.listdir('/proc/self/task')), os.environ['OMP_NUM_THREADS'])"

    def threads(**settings: str) -> str:
        unset = {name: value for name, value in os.environ.items() if not name.endswith("_THREADS")}
        command = [sys.executable, "-c", script]
        ended = subprocess.run(command, env={**unset, **settings}, capture_output=True, text=True, check=True)
        return ended.stdout.strip()

    assert threads() == "1 1"
    assert threads(OMP_NUM_THREADS="2", OPENBLAS_NUM_THREADS="2") == "2 2"
