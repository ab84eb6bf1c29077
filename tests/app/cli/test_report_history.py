"""Reports compared and charted: like with like, intervals, verdicts in words, lasting changes."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from typer.testing import CliRunner

from app.cli.console import OptionRefused
from app.cli.main import app
from app.cli.reports.comparison import verdict
from app.cli.reports.figures import FiledReport, not_stated, read_filed, unlike
from app.cli.robots.history_charts import (
    alarm_sentences,
    chart_tests,
    group_comparable,
    read_events,
    series_of,
)
from core.metrology import estimate_difference

CONDITIONS = {"load_kg": 5.0, "speed_percent": 100.0, "temperature_c": 20.0}


def content(number: int = 1, *, rp_mm: float = 0.05, poses: int = 3, **changes: Any) -> bytes:
    """The JSON form of a repeatability report, of what is read of it."""
    conditions = {**CONDITIONS, **changes.get("conditions", {})}
    commanded = [
        {
            "pose_id": f"P{k}",
            "position_mm": [100.0 * k, 0.0, changes.get("height_mm", 0.0)],
            **dict.fromkeys(("roll_deg", "pitch_deg", "yaw_deg"), 0.0),
            "joint_angles_deg": None,
        }
        for k in range(1, poses + 1)
    ]
    found = [
        {
            "pose_id": one["pose_id"],
            "repeatability": {"rp_l_mm": rp_mm},
            "interval": {"rp_l_mm": [0.8 * rp_mm, 1.3 * rp_mm]},
            "noise_floor": {"rp_l_mm": 0.004},
            "accuracy": None,
        }
        for one in commanded
    ]
    document = {
        "format": "gridpose-report",
        "format_version": 1,
        "report_id": f"rep_{number}",
        "kind": "repeatability",
        "made_at": f"2026-02-{number % 28 + 1:02d}T00:00:00Z",
        "source": changes.get("source", "images"),
        "subject": {
            "session": {"id": f"ses_{number}", "name": changes.get("name", f"week {number}")},
            "first_captured_at": f"2026-{number // 28 + 1:02d}-{number % 28 + 1:02d}T00:00:00Z",
        },
        "inputs": {
            "robot": {"id": changes.get("robot", "rob_1")},
            "session": {"conditions": conditions},
            "poses": commanded,
        },
        "analyses": {"repeatability": {"poses": found}},
    }
    return json.dumps(document).encode()


def filed(number: int = 1, **changes: Any) -> FiledReport:
    return read_filed(content(number, **changes), "a report")


def test_the_format_is_that_of_reports() -> None:
    from app.reports.forms import FORMAT, FORMAT_VERSION

    assert (json.loads(content())["format"], json.loads(content())["format_version"]) == (
        FORMAT,
        FORMAT_VERSION,
    )


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"robot": "rob_2"}, "robots"),
        ({"source": "measured_poses"}, "instrument"),
        ({"poses": 4}, "P4"),
        ({"height_mm": 0.1}, "P1, P2, P3"),
        ({"conditions": {"load_kg": 2.0}}, "load"),
        ({"conditions": {"speed_percent": 50.0}}, "speed"),
        ({"conditions": {"temperature_c": 22.5}}, "temperature"),
    ],
)
def test_what_makes_sessions_unlike_is_named(changes: dict[str, Any], word: str) -> None:
    (reason,) = unlike(filed(1), filed(2, **changes))
    assert word in reason


def test_sessions_of_one_test_are_alike_and_what_is_not_stated_is_named() -> None:
    assert unlike(filed(1), filed(2, height_mm=0.005, conditions={"temperature_c": 21.5})) == []
    unstated = filed(2, conditions={"temperature_c": None})
    assert unlike(filed(1), unstated) == []
    assert not_stated(filed(1), unstated) == ["the temperature (°C)"]


@pytest.mark.parametrize(
    "wrong", [b"", b"[]", b"{}", b"null", b'{"format": 1}', content().replace(b"rp_l_mm", b"x")]
)
def test_other_files_are_refused(wrong: bytes) -> None:
    with pytest.raises(OptionRefused) as refused:
        read_filed(wrong, "thesis.json")
    assert "thesis.json" in str(refused.value)
    assert refused.value.advice


def test_a_report_of_a_later_version_is_refused() -> None:
    later = content().replace(b'"format_version": 1', b'"format_version": 99')
    with pytest.raises(OptionRefused, match="later version"):
        read_filed(later, "new.json")


def test_few_changes_among_many_figures_are_chance() -> None:
    same = estimate_difference(0.05, (0.04, 0.065), 0.05, (0.04, 0.065))
    more = estimate_difference(0.05, (0.04, 0.065), 0.2, (0.16, 0.26))
    many = {(f"pose P{k}", "RP_l"): same for k in range(30)}
    assert "No change is shown" in verdict(many, [])
    assert "no change is shown" in verdict({**many, ("pose P0", "RP_l"): more}, [])
    assert "something changed" in verdict({("pose P1", "RP_l"): more, ("pose P2", "RP_l"): more}, [])
    assert "not comparable (the load differs)" in verdict({("pose P1", "RP_l"): more}, ["the load differs"])
    assert verdict({}, []) == "Nothing can be compared."


def test_two_files_are_compared_without_a_service(tmp_path: Path) -> None:
    for number, rp_mm in ((1, 0.05), (2, 0.12)):
        (tmp_path / f"{number}.json").write_bytes(content(number, rp_mm=rp_mm))
    ended = CliRunner().invoke(app, ["report", "compare", str(tmp_path / "2.json"), str(tmp_path / "1.json")])
    assert ended.exit_code == 0, ended.output
    assert ended.output.index("week 1") < ended.output.index("week 2")  # the earlier first, as given or not
    assert "× 2.4" in ended.output
    assert "3 of 3 figures are larger" in ended.output
    (tmp_path / "2.json").write_bytes(content(2, rp_mm=0.12, conditions={"load_kg": 1.0}))
    ended = CliRunner().invoke(app, ["report", "compare", str(tmp_path / "1.json"), str(tmp_path / "2.json")])
    assert ended.exit_code == 1
    assert "need not be the robot's" in " ".join(ended.output.split())


def test_a_lasting_change_is_said_of_the_sessions_that_are_alike() -> None:
    rng = np.random.default_rng(3)
    reports = [
        filed(k, rp_mm=float(0.05 * np.exp(rng.normal(0.0, 0.05)) * (1.3 if k >= 20 else 1.0)))
        for k in range(1, 31)
    ]
    reports[4:4] = [filed(90, rp_mm=0.5, conditions={"load_kg": 1.0})]
    tests = group_comparable(reports)
    assert [len(test) for test in tests] == [30, 1]
    charts = chart_tests(tests)
    assert charts[1] == {}
    (sentence,) = alarm_sentences(tests[0], charts[0])
    assert sentence.startswith("RP_l all poses went up, from 0.0")
    since = int(sentence.split("week ")[1].split()[0])
    assert abs(since - 20) <= 2
    assert series_of(tests[0])[("all poses", "noise floor")][0][1] == pytest.approx(0.004)
    assert chart_tests([tests[0][:19]])[0][("all poses", "RP_l")].alarm is None


def test_events_restart_charts_where_they_say_so(tmp_path: Path) -> None:
    path = tmp_path / "events.csv"
    path.write_text("at,note,restarts\n2026-01-06,gearbox,yes\n2026-01-03,grease,\n", encoding="utf-8")
    events = read_events(path)
    assert [event.note for event in events] == ["grease", "gearbox"]
    tests = group_comparable([filed(k) for k in range(1, 10)], events)
    assert [len(test) for test in tests] == [4, 5]  # the sixth of January has session 5


@pytest.mark.parametrize(
    "text", ["", "at\n2026-01-06\n", "at,note\nyesterday,x\n", "at,note,restarts\n2026-01-06,x,maybe\n"]
)
def test_other_lists_of_events_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "events.csv"
    path.write_text(text, encoding="utf-8")
    if not text:
        assert read_events(path) == []
        return
    with pytest.raises(OptionRefused):
        read_events(path)


def test_the_history_of_a_robot_is_read_from_its_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The service is stood in for by what it answers: sixty reports, two of one session, one of another robot."""
    stored = {f"rep_{k}": content(k, rp_mm=0.05 + 0.02 * (k > 9) + 0.001 * (k % 3)) for k in range(1, 19)}
    stored["rep_98"] = content(18, rp_mm=0.071, name="=week 18")
    stored["rep_99"] = content(99, robot="rob_2")

    class Service:
        def items(self, path: str) -> list[dict[str, str]]:
            assert path == "/v1/reports"
            return [{"id": name, "status": "succeeded", "kind": "repeatability"} for name in stored]

        def get_bytes(self, path: str) -> bytes:
            return stored[path.removeprefix("/v1/reports/").removesuffix(".json")]

    def run(_access: Any, act: Any) -> int:
        act(Service())
        return 0

    monkeypatch.setattr("app.cli.options.access.ReadAccess.run", run)
    monkeypatch.setattr(
        "app.cli.robots.history.find_robot", lambda _client, name: {"id": name, "name": "<arm> & co"}
    )
    table, drawing, events = (tmp_path / name for name in ("history.csv", "history.svg", "events.csv"))
    events.write_text("at,note,restarts\n2026-01-10T12:00:00,new belt,no\n", encoding="utf-8")
    options = ("--csv", table, "--svg", drawing, "--events", events)
    ended = CliRunner().invoke(app, ["robots", "history", "rob_1", *map(str, options)])
    assert ended.exit_code == 1, ended.output
    said = " ".join(ended.output.split())
    assert "went up" in said
    assert "Before it: new belt" in said
    title, drawn = ElementTree.parse(drawing).getroot()[:2]
    assert title.text == "History of <arm> & co"
    assert "noise floor all poses, test 1: No lasting change is shown." in str(drawn.text)
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert {row["figure"] for row in rows} == {"RP_l", "noise floor"}
    assert len(rows) == 2 * 18
    assert "'=week 18" in {row["session"] for row in rows}
    assert {row["alarm"] for row in rows} == {"", "since", "shown"}
