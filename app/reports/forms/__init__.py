"""Forms of a stored report: its document as JSON, HTML, PDF, CSV, and as the XML of a calibration certificate.

`render_forms` takes the document, which is plain values, and the drawings that belong to it. Every form is drawn from
these alone. `figures` names each number of a document, for the CSV form and for whoever compares two documents.
"""

from app.reports.forms.figures import figures_of
from app.reports.forms.rendering import FORMAT, FORMAT_VERSION, RenderingFailed, render_forms
from app.reports.forms.repeatability import VERDICTS
from app.reports.forms.template import CompanyTemplate, TemplateInvalid, read_template
from app.reports.forms.wording import SENTENCES, symbols, words

__all__ = [
    "FORMAT",
    "FORMAT_VERSION",
    "SENTENCES",
    "VERDICTS",
    "CompanyTemplate",
    "RenderingFailed",
    "TemplateInvalid",
    "figures_of",
    "read_template",
    "render_forms",
    "symbols",
    "words",
]
