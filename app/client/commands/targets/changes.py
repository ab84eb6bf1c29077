"""`gridpose targets change`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ... import Json, find_target
from ..access import UploadAccess
from ..console import OptionRefused
from ..creation import AcceptImplausible, ChangesFile
from ..record_files import read_mapping
from .description import PitchSigma, PrintKind


def change(
    target: Annotated[
        str, typer.Argument(help="Id or name of the target, or sheet: and the id on its print.")
    ],
    service: UploadAccess,
    name: Annotated[str | None, typer.Option(help="The target's new name.")] = None,
    pitch_sigma_mm: PitchSigma = None,
    print_kind: PrintKind = None,
    certificate: Annotated[
        Path | None,
        typer.Option(
            help="JSON or YAML with what a laboratory measured, under the names of the API.",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    file: ChangesFile = None,
    accept_implausible: AcceptImplausible = False,
) -> None:
    """Change a target's name, or what is known of its print: its pitch's uncertainty, its kind, its certificate.

    Its grid never changes: for another pitch make another target, and give it to the session (`gridpose sessions change
    SESSION --target TARGET`). Analyses use the change from now on. To remove a certificate, give a --file with
    {"certificate": null}.
    """
    with service.connect(file) as client:
        changes: Json = read_mapping(file) if file is not None else {}
        if name is not None:
            changes["name"] = name
        if pitch_sigma_mm is not None:
            changes["pitch_standard_uncertainty_mm"] = pitch_sigma_mm
        if print_kind is not None:
            changes["print_kind"] = str(print_kind)
        if certificate is not None:
            changes["certificate"] = read_mapping(certificate)
        if not changes:
            raise OptionRefused(
                "Nothing is to be changed.",
                "Give --name, --pitch-sigma-mm, --print-kind, --certificate or --file.",
            )
        target_id = find_target(client, target)["id"]
        client.change(f"/v1/targets/{target_id}", changes, accept_implausible=accept_implausible or None)
        print(f"{target_id} changed")
