"""Sheets of targets, drawn from the same layout data that detection uses, as PDF and SVG."""

from app.printing.layout import PAPER_SIZES_MM, Paper, Sheet
from app.printing.pdf_svg import to_pdf, to_svg
from app.printing.sheet import describe, draw_sheet
from app.printing.sheet_id import sheet_id_of

__all__ = ["PAPER_SIZES_MM", "Paper", "Sheet", "describe", "draw_sheet", "sheet_id_of", "to_pdf", "to_svg"]
