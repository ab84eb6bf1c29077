"""`gridpose report create`, `list`, `show` and `fetch`."""

from __future__ import annotations

import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from ... import ClientError, Json, find_session
from ..access import ReadAccess, UploadAccess
from ..console import fail, print_json, print_list
from ..output_files import write_file

_COLUMNS = ("id", "kind", "status", "made", "title")
_POLL_S = 0.5
Session = Annotated[str, typer.Argument(help="Id or name of the session.")]
ReportId = Annotated[str, typer.Argument(metavar="REPORT", help="Id of the report.")]


class Kind(StrEnum):
    """What a report is on."""

    repeatability = "repeatability"
    kinematics = "kinematics"
    camera = "camera"
    session = "session"


class Form(StrEnum):
    """Forms of a report."""

    pdf = "pdf"
    html = "html"
    json = "json"
    csv = "csv"
    xml = "xml"


class Paper(StrEnum):
    """Paper of the PDF."""

    a4 = "a4"
    letter = "letter"


def create(
    session: Session,
    service: UploadAccess,
    kind: Annotated[Kind, typer.Option(help="What the report is on.")] = Kind.repeatability,
    title: Annotated[
        str | None, typer.Option(help="What stands at its head.  [default: kind and session]")
    ] = None,
    signatory: Annotated[
        list[str] | None,
        typer.Option(help="Who is to sign it by hand, NAME or NAME:ROLE; repeat it for several."),
    ] = None,
    paper: Annotated[Paper, typer.Option(help="Paper of the PDF.")] = Paper.a4,
    wait: Annotated[bool, typer.Option(help="Wait until it is made.")] = True,
) -> None:
    """Make a report of a session as it is now; it is stored, signed, and never changes.

    Prints the report's id as the last line.
    """
    with service.connect() as client:
        session_id = find_session(client, session)["id"]
        body: dict[str, Any] = {
            "kind": kind.value,
            "title": title,
            "signatories": [_signatory(one) for one in signatory or ()],
            "paper": paper.value,
        }
        report = client.create(f"/v1/sessions/{session_id}/reports", body)
        while wait and report["status"] in ("queued", "running"):
            time.sleep(_POLL_S)
            report = client.get(f"/v1/reports/{report['id']}")
        if report["status"] == "failed":
            failure = report["failure"]
            raise ClientError(failure["code"], failure["detail"], failure["advice"])
        print(report["id"])


def show_list(
    service: ReadAccess,
    session: Annotated[
        str | None, typer.Argument(help="Id or name of a session: its reports alone.  [default: all]")
    ] = None,
    option: Annotated[str | None, typer.Option("--session", help="The session, as an option.")] = None,
) -> None:
    """List stored reports, those of deleted sessions too."""

    if session is not None and option is not None:
        fail("The session is given twice.", "Give it as the argument or by --session.", code=2)
    chosen = session if session is not None else option

    with service.connect() as client:
        query = {"session_id": find_session(client, chosen)["id"]} if chosen is not None else {}
        rows = [
            (one["id"], one["kind"], one["status"], one["finished_at"] or "", one["title"])
            for one in client.items("/v1/reports", **query)
        ]
        print_list(_COLUMNS, rows, "There are no reports yet; `gridpose report create --help` says how.")


def show(report: ReportId, service: ReadAccess) -> None:
    """Print what a report is, and the hashes of its forms."""
    with service.connect() as client:
        print_json(client.get(f"/v1/reports/{report}"))


def fetch(
    report: ReportId,
    service: ReadAccess,
    form: Annotated[Form, typer.Option("--form", help="Which form.")] = Form.pdf,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File.  [default: the report's id with the form]")
    ] = None,
) -> None:
    """Save a form of a report, and its detached signature alongside it."""
    with service.connect() as client:
        target = output or Path(f"{report}.{form.value}")
        content = client.get_bytes(f"/v1/reports/{report}.{form.value}")
        signature = client.get_bytes(f"/v1/reports/{report}.sig")
        write_file(target, content)
        write_file(target.with_name(target.name + ".sig"), signature)
        print(target)


def _signatory(text: str) -> Json:
    name, _, role = text.partition(":")
    return {"name": name.strip(), "role": role.strip() or None}
