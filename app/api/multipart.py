"""A multipart form read as it arrives: one file straight to its destination, small fields in memory."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from app.errors import InvalidContent, TooLarge

if TYPE_CHECKING:
    from python_multipart.multipart import MultipartCallbacks

MAX_FIELDS = 20
MAX_FIELD_BYTES = 64 * 1024
MAX_HEADER_BYTES = 16 * 1024
_CUT_SHORT = "ends before the form does"


@dataclass(slots=True)
class Form:
    """The text fields of a form, and the name of the file it held."""

    fields: dict[str, str] = field(default_factory=dict)
    filename: str | None = None
    has_file: bool = False


def boundary_of(content_type: str) -> bytes | None:
    """Return the boundary of a multipart form, None where the body is no such form."""
    media_type, parameters = parse_options_header(content_type)
    boundary = parameters.get(b"boundary", b"")
    return boundary if media_type == b"multipart/form-data" and 0 < len(boundary) <= 200 else None


async def read_form(
    chunks: AsyncIterator[bytes],
    boundary: bytes,
    *,
    file_field: str,
    write: Callable[[bytes], Awaitable[None]],
) -> Form:
    """Read a form whose one file, in `file_field`, goes to `write` piece by piece."""
    reader = _Reader(file_field)
    try:
        # Its own limit is beyond that of the reader, which says what is too long.
        parser = MultipartParser(boundary, reader.callbacks(), max_header_size=2 * MAX_HEADER_BYTES)
        async for chunk in chunks:
            parser.write(chunk)
            for piece in reader.take_file_data():
                await write(piece)
    except FormParserError:
        raise _invalid("is not a valid multipart form") from None
    try:
        parser.finalize()
    except FormParserError:
        raise _invalid(_CUT_SHORT) from None
    if not reader.complete:
        raise _invalid(_CUT_SHORT)
    return reader.form


def _invalid(message: str, name: str = "body") -> InvalidContent:
    return InvalidContent(
        "The form cannot be read.",
        "Send multipart/form-data with the file in `image` and text fields next to it.",
        code="invalid_form",
        errors=[(name, message)],
    )


class _Reader:
    """The parser's callbacks and what they have gathered."""

    def __init__(self, file_field: str) -> None:
        self.form = Form()
        self.complete = False
        self._file_field = file_field
        self._file_data: list[bytes] = []
        self._header_name = b""
        self._header_value = b""
        self._disposition = b""
        self._name = ""
        self._text: bytearray | None = None

    def callbacks(self) -> MultipartCallbacks:
        return {
            "on_part_begin": self._on_part_begin,
            "on_part_data": self._on_part_data,
            "on_part_end": self._on_part_end,
            "on_header_field": self._on_header_field,
            "on_header_value": self._on_header_value,
            "on_header_end": self._on_header_end,
            "on_headers_finished": self._on_headers_finished,
            "on_end": self._on_end,
        }

    def take_file_data(self) -> list[bytes]:
        """Return the pieces of the file that came in since the last call."""
        pieces, self._file_data = self._file_data, []
        return pieces

    def _on_part_begin(self) -> None:
        self._header_name = self._header_value = self._disposition = b""

    def _on_header_field(self, data: bytes, start: int, end: int) -> None:
        self._header_name += data[start:end]
        self._check_header()

    def _on_header_value(self, data: bytes, start: int, end: int) -> None:
        self._header_value += data[start:end]
        self._check_header()

    def _check_header(self) -> None:
        if len(self._header_name) + len(self._header_value) > MAX_HEADER_BYTES:
            raise _invalid("has a part with too long a header")

    def _on_header_end(self) -> None:
        if self._header_name.lower() == b"content-disposition":
            self._disposition = self._header_value
        self._header_name = self._header_value = b""

    def _on_headers_finished(self) -> None:
        _, options = parse_options_header(self._disposition)
        try:
            self._name = options[b"name"].decode("utf-8")
            filename = options[b"filename"].decode("utf-8", "replace") if b"filename" in options else None
        except (KeyError, UnicodeDecodeError):
            raise _invalid("has a part without a readable name") from None
        if self._name == self._file_field:
            if self.form.has_file:
                raise _invalid("is sent more than once", self._file_field)
            self.form.has_file, self.form.filename = True, filename
            self._text = None
            return
        if self._name in self.form.fields:
            raise _invalid("is sent more than once", self._name[:100])
        if len(self.form.fields) >= MAX_FIELDS:
            raise _invalid("has too many fields")
        self._text = bytearray()

    def _on_part_data(self, data: bytes, start: int, end: int) -> None:
        if self._text is None:
            self._file_data.append(data[start:end])
            return
        self._text += data[start:end]
        if len(self._text) > MAX_FIELD_BYTES:
            raise TooLarge(f"The field has more than {MAX_FIELD_BYTES} bytes.", "Send a shorter value.")

    def _on_part_end(self) -> None:
        if self._text is not None:
            try:
                self.form.fields[self._name] = self._text.decode("utf-8")
            except UnicodeDecodeError:
                raise _invalid(
                    f"is not UTF-8 text; the file's field is {self._file_field}", self._name[:100]
                ) from None

    def _on_end(self) -> None:
        self.complete = True
