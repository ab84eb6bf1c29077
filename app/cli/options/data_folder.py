"""Options that several commands on a data folder share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

DataDir = Annotated[
    Path | None,
    typer.Option(
        "--data-dir", help="Folder of the service's data.  [default: GRIDPOSE_DATA_DIR, else the user's]"
    ),
]
