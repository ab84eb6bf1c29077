"""Options of `gridpose demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.cli.demo.command import run_demo
from app.cli.demo.paper import reproduce


def demo(
    data_dir: Annotated[
        Path | None, typer.Option(help="Keep the session here.  [default: a new temporary folder]")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the rendered session.")] = 1,
    paper: Annotated[
        bool, typer.Option("--paper", help="The whole experiment of Boby and Saha: Tables II to IV.")
    ] = False,
    quick: Annotated[
        bool, typer.Option("--quick", help="With --paper: a quarter of the pixels, fewer cycles and poses.")
    ] = False,
) -> int:
    """Run a small rendered session with known truth through the real service, and compare."""
    if paper:
        return reproduce(data_dir, seed, quick)
    if quick:
        raise typer.BadParameter("belongs to --paper: give both.", param_hint="--quick")
    return run_demo(data_dir, seed)
