"""Output that its stream cannot encode or cannot take."""

from __future__ import annotations

import errno
import io
import sys
from typing import Any

import pytest

from app.client.commands.console import print_list
from app.client.commands.main import run
from app.client.commands.output_files import write_text


class FullDisk(io.RawIOBase):
    """A file on a disk without space."""

    def __init__(self, code: int) -> None:
        self.code = code
        self.is_full = True

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        if self.is_full:
            raise OSError(self.code, "no space")
        return len(data)


def windows_pipe(monkeypatch: pytest.MonkeyPatch) -> io.BytesIO:
    """Make stdout what it is in a pipe on Windows, and return what is written there."""
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="cp1252", newline="\r\n"))
    return written


def test_characters_that_stdout_cannot_encode_are_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    written = windows_pipe(monkeypatch)
    run(lambda: print_list(("id", "name"), [("s", "Zelle ν → ü")], ""))
    assert "Zelle ? ? ü".encode("cp1252") in written.getvalue()


def test_an_export_is_utf8_whatever_stdout_is(monkeypatch: pytest.MonkeyPatch) -> None:
    written = windows_pipe(monkeypatch)
    run(lambda: write_text("pose,u\nν,1\n", None))
    assert written.getvalue() == "pose,u\nν,1\n".encode()


@pytest.mark.parametrize(("code", "is_reported"), [(errno.ENOSPC, True), (errno.EPIPE, False)])
@pytest.mark.parametrize("is_buffered", [True, False])
def test_output_that_cannot_be_written_ends_with_1(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    code: int,
    is_reported: bool,
    is_buffered: bool,
) -> None:
    disk = FullDisk(code)
    buffer = io.BufferedWriter(disk) if is_buffered else disk
    stream = io.TextIOWrapper(buffer, encoding="utf-8", write_through=not is_buffered)  # type: ignore[arg-type]
    with monkeypatch.context() as patched:
        patched.setattr(sys, "stdout", stream)
        with pytest.raises(SystemExit) as ended:
            run(lambda: print("ids"))
    assert ended.value.code == 1
    assert bool(capsys.readouterr().err) is is_reported
    disk.is_full = False  # else closing the stream fails
