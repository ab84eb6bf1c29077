"""What the forms of a report carry beyond their text."""

from __future__ import annotations

import json
import tarfile

import pypdfium2

from app.reports.forms import CompanyTemplate, render_forms
from tests.reference.archives.make import FOLDER


def test_the_pdf_carries_the_document_and_the_files_that_belong_to_it() -> None:
    with tarfile.open(FOLDER / "schema-0019.tar.gz") as archive:
        member = next(one for one in archive if one.name.endswith("/report.json"))
        document = json.load(archive.extractfile(member))  # type: ignore[arg-type]
    forms = render_forms(document, {}, CompanyTemplate(), {"robot.urdf": "<robot name='\u00e4'/>\n"})
    pdf = pypdfium2.PdfDocument(forms["pdf"])
    carried = {
        one.get_name(): bytes(one.get_data())
        for one in map(pdf.get_attachment, range(pdf.count_attachments()))
    }
    assert carried == {"report.json": forms["json"], "robot.urdf": "<robot name='\u00e4'/>\n".encode()}
    for page in pdf:
        assert document["report_id"] in page.get_textpage().get_text_range()
