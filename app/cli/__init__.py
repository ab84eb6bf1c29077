"""The command line: one folder a noun, `main` lists every command."""

from app.cli.main import main

__all__ = ["main"]
