"""Messages of the commands: those of the client and those of the service print by the same means."""

from __future__ import annotations

from app.client.commands import OptionRefused, error_console, fail, output_console, print_error, print_list

__all__ = ["OptionRefused", "error_console", "fail", "output_console", "print_error", "print_list"]
