"""What codecs write to stderr is logged, and nothing else is lost."""

from __future__ import annotations

import logging
import os
import threading

import cv2
import numpy as np
import pytest

from core.image.codec_messages import codec_messages_logged
from core.image.decoding import decode
from core.image.preview import decode_preview


def damaged_jpeg() -> bytes:
    """Return a JPEG whose image data are wrong inside, though its segments are whole."""
    noise = np.random.default_rng(1).integers(0, 255, (96, 128)).astype(np.uint8)
    data = bytearray(cv2.imencode(".jpg", noise)[1].tobytes())
    middle = len(data) // 2
    data[middle : middle + 200] = bytes(200)
    return bytes(data)


def test_a_damaged_jpeg_leaves_no_line_on_stderr(
    capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.DEBUG, logger="core.image.codec_messages"):
        assert decode(damaged_jpeg()).shape == (96, 128)
        decode_preview(damaged_jpeg(), longest_side_px=64)
    assert capfd.readouterr().err == ""
    assert len(caplog.records) >= 2
    assert {record.levelno for record in caplog.records} == {logging.DEBUG}


def test_what_others_write_meanwhile_is_passed_on(capfd: pytest.CaptureFixture[str]) -> None:
    with codec_messages_logged():
        os.write(2, b"out of memory\nCorrupt JPEG data: 3 extraneous bytes\nlast words")
    os.write(2, b"!")
    assert capfd.readouterr().err == "out of memory\nlast words!"


def test_threads_that_decode_at_the_same_time_leave_stderr_as_it_was(
    capfd: pytest.CaptureFixture[str],
) -> None:
    inside, leave = threading.Event(), threading.Event()

    def decoding() -> None:
        with codec_messages_logged():
            inside.set()
            leave.wait()

    other = threading.Thread(target=decoding)
    with codec_messages_logged():
        other.start()
        inside.wait()
    os.write(2, b"first\n")
    leave.set()
    other.join()
    os.write(2, b"second\n")
    assert capfd.readouterr().err == "first\nsecond\n"


def test_without_stderr_an_image_is_decoded_all_the_same() -> None:
    kept = os.dup(2)
    os.close(2)
    try:
        assert decode(damaged_jpeg()).shape == (96, 128)
    finally:
        os.dup2(kept, 2)
        os.close(kept)
