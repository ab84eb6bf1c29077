"""`gridpose version` of the client."""

from __future__ import annotations

from .. import __version__


def show_version() -> int:
    """Print the installed version and build."""
    print(f"{__version__} (client)")
    return 0
