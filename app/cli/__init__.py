"""The `gridpose` command: one module per subcommand, imported only when it runs.

`gridpose upload` therefore starts on a shop-floor PC without loading the service's database or job runner.
"""

from app.cli.commands import main

__all__ = ["main"]
