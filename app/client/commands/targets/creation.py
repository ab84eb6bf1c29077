"""`gridpose targets create`."""

from __future__ import annotations

from ... import Json, ServiceClient
from ..access import UploadAccess
from ..creation import AcceptImplausible, BodyFile, Name, create_named
from .description import PitchSigma, PrintKind, TargetDescription


def create(
    service: UploadAccess,
    description: TargetDescription,
    name: Name = None,
    pitch_sigma_mm: PitchSigma = None,
    print_kind: PrintKind = None,
    file: BodyFile = None,
    accept_implausible: AcceptImplausible = False,
) -> None:
    """Make a target: what is printed, how many grid points it has, and their distance.

    For example: gridpose targets create "A4 board" --kind chessboard --columns 9 --rows 6 --pitch-mm 25

    Prints the target's id as the last line.
    """

    def fields(_: ServiceClient) -> Json:
        given = description.fields()
        if pitch_sigma_mm is not None:
            given["pitch_standard_uncertainty_mm"] = pitch_sigma_mm
        if print_kind is not None:
            given["print_kind"] = str(print_kind)
        return given

    needed = {"kind": "--kind", "columns": "--columns", "rows": "--rows", "pitch_mm": "--pitch-mm"}
    with service.connect(file) as client:
        create_named(
            client,
            "target",
            name,
            file,
            fields,
            needed,
            "gridpose sessions create NAME --target {id}",
            accept_implausible=accept_implausible,
        )
