"""Many items through worker processes that may crash or hang, every finding with the number that repeats it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

_ROOT = Path(__file__).parents[3]
_STUCK_S = 120.0
"""So long a worker may report nothing: far beyond its limit of processor time, on however busy a machine."""
_MOST_FINDINGS = 20


@dataclass
class Campaign:
    """What came of a range of items."""

    outcomes: Counter[str] = field(default_factory=Counter)
    findings: list[str] = field(default_factory=list)
    items: int = 0


def run_items(kind: str, begin: int, end: int, *, processes: int = 1, stuck_s: float = _STUCK_S) -> Campaign:
    """Run items `begin` to before `end` in as many processes at a time, in parts of a thousand."""
    size = max(1, min(1000, -(-(end - begin) // processes)))
    starts = range(begin, end, size)
    whole = Campaign()
    with ThreadPoolExecutor(processes) as pool:
        for part in pool.map(lambda start: _run_part(kind, start, min(start + size, end), stuck_s), starts):
            whole.outcomes += part.outcomes
            whole.findings += part.findings
            whole.items += part.items
            if len(whole.findings) > _MOST_FINDINGS:
                pool.shutdown(cancel_futures=True)
                break
    return whole


def _run_part(kind: str, begin: int, end: int, stuck_s: float) -> Campaign:
    """Run items one after the other, in a new process after one that ended it."""
    part = Campaign()
    while begin < end and len(part.findings) <= _MOST_FINDINGS:
        last, death = _run_worker(kind, begin, end, part, stuck_s)
        if death is None:
            break
        again = "at once"
        if last is None:
            part.findings.append(f"the worker for {kind} {begin} died before its first item: {death}")
            break
        if (
            death == signal.SIGPROF.name
        ):  # the first of its sort may have had to compile a kernel: once is no hang
            _, again = _run_worker(kind, last, last + 1, Campaign(), stuck_s)
        if again is not None:
            part.findings.append(f"{kind} {last}: ended by {death}")
        begin = last + 1
    return part


def _run_worker(
    kind: str, begin: int, end: int, part: Campaign, stuck_s: float
) -> tuple[int | None, str | None]:
    """Run one process; return the last item it began, and what ended it if it did not end by itself."""
    with tempfile.TemporaryDirectory() as folder:
        report, complaints = Path(folder, "report"), Path(folder, "complaints")
        command = [sys.executable, "-m", "tests.core.fuzz.worker", kind, str(begin), str(end), str(report)]
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        with complaints.open("wb") as stderr:
            process = subprocess.Popen(command, cwd=_ROOT, env=environment, stderr=stderr)
            death = _wait(process, report, stuck_s)
        lines = (
            [json.loads(line) for line in report.read_text("utf-8").splitlines()] if report.exists() else []
        )
        begun = [line for line in lines if isinstance(line, int)]
        for line in lines:
            if isinstance(line, dict) and "finding" in line:
                part.findings.append(f"{kind} {line['number']}: {line['finding']}")
            elif isinstance(line, dict):
                part.outcomes.update(line["outcomes"])
        part.items += len(begun)
        if death is not None and not begun:
            death += "\n" + complaints.read_text("utf-8", errors="replace")[-2000:]
        return (begun[-1] if begun else None), death


def _wait(process: subprocess.Popen[bytes], report: Path, stuck_s: float) -> str | None:
    """Wait while the report grows; return what ended the process, or None if all went well.

    Until its first item it loads and compiles, as long as that takes on a busy machine.
    """
    written, deadline = None, time.monotonic() + _STUCK_S
    while True:
        try:
            code = process.wait(timeout=stuck_s)
        except subprocess.TimeoutExpired:
            now = report.stat().st_size if report.exists() else 0
            if now == written and (now > 0 or time.monotonic() > deadline):
                process.kill()
                process.wait()
                return f"no sign of life for {stuck_s:g} s"
            written = now
            continue
        if code == 0:
            return None
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"
