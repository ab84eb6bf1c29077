"""A sheet as PDF and as SVG: vectors in millimetres, the same bytes for the same sheet.

In both, everything is one outline filled black. The PDF also holds its text invisibly, so that it can be searched and
copied, and asks viewers to print without scaling.

References: ISO 32000-1:2008, 8.5 (paths), 9.3.6 (invisible text), 12.2 (PrintScaling).
"""

from __future__ import annotations

import math

from app.markup import element_text, legal_text
from app.printing.glyphs import LETTERS_MM
from app.printing.layout import Sheet, Text
from app.printing.outlines import Path

_POINTS_PER_MM = 72.0 / 25.4
_PDF_OPERATORS = {"M": "m", "L": "l", "C": "c", "Z": "h"}


def to_svg(sheet: Sheet) -> bytes:
    """Return the sheet as an SVG document of the paper's size."""
    width, height = (_number(v) for v in (sheet.paper.width_mm, sheet.paper.height_mm))
    paths = "\n".join(
        "".join(f"{op}{' '.join(map(_number, values))}" for op, values in path) for path in sheet.outlines
    )
    text = " ".join(line.text for line in sheet.texts)
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm" '
        f'viewBox="0 0 {width} {height}" role="img">\n'
        f"<title>{element_text(sheet.title)}</title>\n<desc>{element_text(text)}</desc>\n"
        f'<rect width="{width}" height="{height}" fill="#fff"/>\n'
        f'<path fill="#000" fill-rule="nonzero" d="{paths}"/>\n</svg>\n'
    ).encode()


def to_pdf(sheet: Sheet) -> bytes:
    """Return the sheet as a PDF document of one page."""
    scale = _number(_POINTS_PER_MM, 9)
    height = _number(sheet.paper.height_mm * _POINTS_PER_MM, 6)
    # From here on millimetres from the upper left corner, y down.
    content = [f"{scale} 0 0 -{scale} 0 {height} cm", "0 g"]
    content += [_pdf_path(path) for path in sheet.outlines]
    content += ["f", "BT", "3 Tr"]
    content += [_pdf_text(line) for line in sheet.texts]
    content.append("ET")
    stream = "\n".join(content).encode("cp1252")
    page_width = _number(sheet.paper.width_mm * _POINTS_PER_MM, 6)
    return _pdf_file(
        [
            b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
            b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {page_width} {height}] /Contents 4 0 R "
            f"/Resources << /Font << /F 5 0 R >> >> >>".encode(),
            b"<< /Length %d >>\nstream\n%s\nendstream" % (len(stream), stream),
            b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
            b"<< /Title %s /Producer (Gridpose) >>" % _pdf_title(sheet.title),
        ]
    )


def _pdf_path(path: Path) -> str:
    return "\n".join(" ".join([*map(_number, values), _PDF_OPERATORS[op]]) for op, values in path)


def _pdf_text(line: Text) -> str:
    place = f"{_number(line.x)} {_number(line.y)}"
    matrix = f"0 -1 -1 0 {place} Tm" if line.upward else f"1 0 0 -1 {place} Tm"
    size = _number(LETTERS_MM / 0.718)  # Helvetica's capitals, of its size
    text = legal_text(line.text).encode("cp1252", "replace").decode("cp1252")
    for special in "\\()":
        text = text.replace(special, "\\" + special)
    return f"/F {size} Tf {matrix} ({text}) Tj"


def _pdf_title(title: str) -> bytes:
    return b"<" + ("\ufeff" + legal_text(title)).encode("utf-16-be", "replace").hex().encode() + b">"


def _pdf_file(objects: list[bytes]) -> bytes:
    """Return the file with its cross-reference table; the first object is its root, the last its information."""
    out = bytearray(b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n")
    begins = []
    for number, body in enumerate(objects, start=1):
        begins.append(len(out))
        out += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    table = len(out)
    out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    out += b"".join(b"%010d 00000 n \n" % begin for begin in begins)
    out += b"trailer\n<< /Size %d /Root 1 0 R /Info %d 0 R >>\n" % (len(objects) + 1, len(objects))
    return bytes(out + b"startxref\n%d\n%%%%EOF\n" % table)


def _number(value: float, digits: int = 4) -> str:
    """Return a number to 0.1 µm, in as few characters as possible."""
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") or not math.isfinite(value) else text
