"""Forms of an answer: JSON, tables as CSV, drawings; which of them a client prefers; and lists sent as CSV."""

from app.api.representations.analysis_answers import (
    CSV_CONTENT,
    ETAG_HEADER,
    POSTED_ANALYSIS,
    FormDep,
    KnownTags,
    PostedFormDep,
    answer_analysis,
    answer_document,
    answer_drawing,
    answer_in_form,
)
from app.api.representations.csv_lists import read_csv_list
from app.api.representations.drawings import (
    AcceptHeader,
    binary_content,
    draw_overlay,
    preferred_media_type,
    stated_media_type,
)
from app.api.representations.list_tables import LIST_CSV, is_page, page_in_form
from app.api.representations.preferences import CSV

__all__ = [
    "CSV",
    "CSV_CONTENT",
    "ETAG_HEADER",
    "LIST_CSV",
    "POSTED_ANALYSIS",
    "AcceptHeader",
    "FormDep",
    "KnownTags",
    "PostedFormDep",
    "answer_analysis",
    "answer_document",
    "answer_drawing",
    "answer_in_form",
    "binary_content",
    "draw_overlay",
    "is_page",
    "page_in_form",
    "preferred_media_type",
    "read_csv_list",
    "stated_media_type",
]
