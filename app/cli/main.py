"""The `gridpose` command of the service: the client's commands, and those that need the service.

The client's table (`app.client.commands`) names every command; this module says where those of the service are
implemented. Their modules are imported only when they run.
"""

from __future__ import annotations

import typer

from app.client.commands import make_app, run
from app.threads import limit_threads

limit_threads()  # commands that compute load numpy later

SERVICE_COMMANDS = {
    "serve": "app.cli.server.serve:serve",
    "worker": "app.cli.server.worker:work",
    "doctor": "app.cli.doctor.command:doctor",
    "backup": "app.cli.server.backup:back_up",
    "restore": "app.cli.server.backup:restore",
    "demo": "app.cli.demo.options:demo",
    "migrate-to": "app.cli.server.migrate_to:migrate_to",
    "keys create": "app.cli.server.keys:create",
    "keys list": "app.cli.server.keys:show",
    "keys revoke": "app.cli.server.keys:revoke",
    "sessions archive": "app.cli.sessions.archive:archive",
    "sessions restore": "app.cli.sessions.archive:restore",
    "schema show": "app.cli.server.schema:show",
    "schema downgrade": "app.cli.server.schema:downgrade",
    "report compare": "app.cli.reports.comparison:compare",
    "report verify": "app.cli.reports.verification:verify",
    "robots history": "app.cli.robots.history:history",
    "robots export": "app.cli.robots.export:export_dh",
    "robots plan dh": "app.cli.robots.plan:plan_dh",
    "robots plan iso9283": "app.cli.robots.iso9283:plan_iso9283",
    "targets print": "app.cli.targets.pdf:print_target",
    "targets check": "app.cli.targets.check:check_target",
}
"""Each command of the client's table that belongs to the service, with the function that implements it."""

app = make_app(SERVICE_COMMANDS, version="app.cli.main:version")


def version() -> int:
    """Print the installed version and build."""
    from app.build import core_version  # it reads the package's metadata, which `--help` does not need

    typer.echo(core_version())
    return 0


def main() -> None:
    """Run the command line."""
    run(app)
