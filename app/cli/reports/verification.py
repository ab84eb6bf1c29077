"""`gridpose report verify`: a file by its signature, or a stored report by computing it anew."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from app.cli.options.access import ReadAccess
from app.client import ServiceClient
from app.client.commands import error_console, fail

_SHOWN = 20


def verify(
    subject: Annotated[
        str,
        typer.Argument(metavar="FILE|REPORT", help="A form that was saved, or the id of a stored report."),
    ],
    service: ReadAccess,
    signature: Annotated[
        Path | None,
        typer.Option(help="The detached signature.  [default: the file's name with .sig]", dir_okay=False),
    ] = None,
    fingerprint: Annotated[
        str | None,
        typer.Option(
            help="The signing key that is trusted: `signing_key` of a report, had from the installation itself."
        ),
    ] = None,
    originals: Annotated[
        bool, typer.Option(help="Of a stored report: measure its originals anew, too.")
    ] = True,
) -> int:
    """Check a saved report by its signature, or compute a stored one anew and compare every figure.

    A file needs no service. Figures are computed from what the report was made from; what was changed in the session
    since is listed. Ends with 1 where the file, or a figure, is not what was signed, or cannot be computed anew.
    """
    path = Path(subject)
    if path.is_file():
        return _verify_file(path, signature or path.with_name(path.name + ".sig"), fingerprint)
    with service.connect() as client:
        agrees = _verify_stored(client, subject, originals)
    return int(not agrees)


def _verify_file(path: Path, signature: Path, trusted: str | None) -> int:
    from app.reports.signature import SignatureUnreadable, check_file

    try:
        content, signed = path.read_bytes(), signature.read_bytes()
    except OSError as error:
        fail(
            f"{error.filename} cannot be read: {error.strerror}.",
            "Save the signature as well: `gridpose report fetch` does, or GET /v1/reports/{id}.sig.",
        )
    try:
        found = check_file(content, signed)
    except SignatureUnreadable as error:
        fail(f"{signature} is no signature of a report: {error}.", "Save it again.")
    if not found.is_signature_valid:
        fail(f"{signature} was changed: its manifest is not the one that was signed.", "Save it again.")
    if found.form is None:
        fail(
            f"{path} is not a form of the report {found.manifest.get('report_id')}, or was changed.",
            "Save it again from the service, and compare.",
        )
    if trusted is not None and trusted.strip().lower() != found.fingerprint:
        fail(
            f"{path} was signed by another key, {found.fingerprint}.",
            "Ask the installation for its key: `signing_key` of one of its reports.",
        )
    print(f"{path}: form {found.form} of report {found.manifest['report_id']}, unchanged")
    print(f"  made         {found.manifest['made_at']} by Gridpose {found.manifest['core_version']}")
    print(f"  signing key  {found.fingerprint}")
    if trusted is None:
        error_console().print(
            "[yellow]Whose key that is was not checked: compare it with the installation's, or give --fingerprint.[/]"
        )
    return 0


def _verify_stored(client: ServiceClient, report_id: str, originals: bool) -> bool:
    found = client.get(f"/v1/reports/{report_id}/verify", originals=str(originals).lower())
    agrees, is_recomputed = bool(found["agrees"]), found["recomputed_from"] != "nothing"
    print(f"{report_id}: {_verdict(found)}")
    if is_recomputed:
        digits = "all digits" if found["digits"] is None else f"at least {found['digits']} digits"
        print(f"  figures    {found['figures_equal']} of {found['figures']} equal; numbers share {digits}")
        also = ", ".join(found["current_values"])
        print(f"  from       {'what the report states' + (f'; as they are now: {also}' if also else '')}")
    else:
        print(
            f"  figures    none: inputs that are not stored as they were: {found['unavailable_input_count']}"
        )
    print(
        f"  originals  {found['originals']['identical']} of {found['originals']['measured']} identical anew"
    )
    print(f"  build      {found['core_version_then']}, now {found['core_version_now']}")
    console = error_console()
    _list_inputs(console, "not stored as it was", "red", found, "unavailable_input")
    _list_inputs(console, "changed since", "yellow", found, "changed_input")
    for form in found["damaged_forms"]:
        console.print(f"[red]the stored form {form} is damaged[/]")
    for one in found["originals"]["differing"][:_SHOWN]:
        console.print(f"[red]image {escape(one['measurement_id'])}: {escape(one['detail'])}[/]")
    for one in found["differences"][:_SHOWN]:
        console.print(f"  {escape(one['path'])}: {one['then']}, now {one['now']}", highlight=False)
    return agrees


def _verdict(found: dict[str, Any]) -> str:
    if found["recomputed_from"] == "nothing":
        return "CANNOT BE COMPUTED ANEW"
    if not found["agrees"]:
        return "DOES NOT AGREE"
    return "agrees" if found["is_current"] else "agrees; the session was changed since"


def _list_inputs(console: Console, head: str, colour: str, found: dict[str, Any], name: str) -> None:
    """Print the inputs of a list, and how many more there are."""
    listed, number = found[f"{name}s"], found[f"{name}_count"]
    for one in listed[:_SHOWN]:
        line = f"{head}: {one['noun'].replace('_', ' ')} {one['name']}: {one['detail']}"
        console.print(f"[{colour}]{escape(line)}[/]", highlight=False)
    if number > _SHOWN:
        console.print(f"and {number - _SHOWN} more")
