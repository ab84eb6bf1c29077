"""The threads in which a service does one step after another."""

from __future__ import annotations

import threading

import pytest

from app.errors import StorageFull, Unavailable
from app.services.installation import loop as loop_module
from app.services.installation.loop import Loop

WITHIN_S = 60.0


def test_a_step_that_fails_does_not_end_the_loop() -> None:
    steps: list[Exception] = [RuntimeError("a defect"), Unavailable("The database is busy.")]
    done = threading.Event()

    def step() -> None:
        if steps:
            raise steps.pop()
        done.set()

    loop = Loop("steps", step, 0.01)
    loop.start()
    assert done.wait(WITHIN_S)
    loop.stop()


def test_what_a_step_is_put_off_for_is_logged_once_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    done, count, lines = threading.Event(), iter(range(5)), list[str]()
    monkeypatch.setattr(loop_module.log, "warning", lambda event, **fields: lines.append(fields["code"]))

    def step() -> None:
        number = next(count, None)
        if number is None:
            done.set()
        raise Unavailable("The database is busy.") if number == 3 else StorageFull("The disk is full.")

    loop = Loop("steps", step, 0.01)
    loop.start()
    assert done.wait(WITHIN_S)
    loop.stop()
    assert sorted(lines) == sorted({Unavailable("").code, StorageFull("").code})


def test_a_loop_goes_on_while_there_is_more_and_waits_until_woken() -> None:
    more, woken, rested = [True, True, False], threading.Event(), threading.Event()

    def step() -> bool:
        if not more:
            woken.set()
            return False
        if len(more) == 1:
            rested.set()
        return more.pop(0)

    loop = Loop("steps", step, 10.0 * WITHIN_S)
    loop.start()
    assert rested.wait(WITHIN_S)
    loop.wake()
    assert woken.wait(WITHIN_S)
    assert not loop.is_stopping()
    loop.stop()
    assert loop.is_stopping()


def test_a_step_in_progress_is_waited_for_and_hears_of_the_end() -> None:
    begun, ended = threading.Event(), threading.Event()

    def step() -> None:
        begun.set()
        while not loop.is_stopping():
            loop.pause(WITHIN_S)
        ended.set()

    loop = Loop("steps", step, 0.0)
    loop.start()
    assert begun.wait(WITHIN_S)
    loop.stop()
    assert ended.is_set()
