"""Messages and files of the commands: those of the client and those of the service write by the same means."""

from __future__ import annotations

from app.client.commands import (
    OptionRefused,
    error_console,
    fail,
    output_console,
    print_error,
    print_list,
    write_file,
)

__all__ = [
    "OptionRefused",
    "error_console",
    "fail",
    "megabytes",
    "output_console",
    "print_error",
    "print_list",
    "write_file",
]


def megabytes(count: int) -> str:
    """Return a number of bytes in MB, as all sizes of originals and files are printed."""
    return f"{count / 1e6:.1f} MB"
