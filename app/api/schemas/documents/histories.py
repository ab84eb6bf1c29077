"""Histories of robots and comparisons of reports as JSON."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.common import AdvisoryRead, ResponseModel
from app.api.schemas.documents.reports import ReportKind
from app.api.schemas.fields import RobotId, SessionId, Source

HistoryKind = TypeAliasType(
    "HistoryKind",
    Annotated[
        Literal["repeatability", "kinematics", "camera", "qualification"],
        Field(description="Of what a history has figures: reports of a kind, or qualifications."),
    ],
)
ChartAxis = TypeAliasType(
    "ChartAxis",
    Annotated[
        Literal["date", "session"],
        Field(description="What control charts are over: dates of measurement, or sessions by their number."),
    ],
)
AlarmMark = TypeAliasType(
    "AlarmMark",
    Annotated[
        Literal["since", "shown"],
        Field(description="`since`: the level is another from here on. `shown`: here that was shown."),
    ],
)
ChangeDirection = TypeAliasType(
    "ChangeDirection", Annotated[Literal["up", "down"], Field(description="Which way a figure went.")]
)
FigureChange = TypeAliasType(
    "FigureChange",
    Annotated[
        Literal["larger", "smaller", "no_change_shown"],
        Field(description="What the interval of a difference shows."),
    ],
)
_OF = "What it is of: `all poses` (the geometric mean of the poses), a joint, a camera, `qualification`."
_FIGURE = "Its name: `RP_l`, `AP_p`, `noise floor`, a parameter, or `worst error` (size), `scale`, `probing scatter`."
_UNIT = "Its unit: `mm`, `deg`, `px`, `ppm`."
_TEST = "Number of the test, from 1."
_MEASURED = (
    "When the session's first image was taken; else when its first image or reading came; else when the report was "
    "made. RFC 3339 in UTC."
)
_INTERVAL = Field(min_length=2, max_length=2)
FigureOf = Annotated[str, Field(description=_OF)]
FigureName = Annotated[str, Field(description=_FIGURE)]
FigureUnit = Annotated[str, Field(description=_UNIT)]
SessionName = Annotated[str, Field(description="The session's name in the report.")]


class HistoryTest(ResponseModel):
    """Sessions that are comparable: same kind, source, commanded poses, load, speed and temperature (2 K)."""

    test: Annotated[int, Field(description=_TEST)]
    test_kind: Annotated[HistoryKind, Field(description="What it has figures of.")]
    source: Annotated[Source | None, Field(description="Where its poses come from; null of qualifications.")]
    camera_name: Annotated[
        str | None,
        Field(description="The qualified camera's name; null of reports, and where it was not stated."),
    ]
    pose_count: Annotated[int, Field(description="Commanded poses.")]
    load_kg: Annotated[float | None, Field(description="Load of its first session, kg; null: not stated.")]
    speed_percent: Annotated[
        float | None, Field(description="Speed of its first session, %; null: not stated.")
    ]
    temperature_c: Annotated[
        float | None, Field(description="Temperature of its first session, °C; null: not stated.")
    ]
    sessions: Annotated[int, Field(description="Sessions that are comparable.")]
    first_measured_at: Annotated[datetime, Field(description=f"Of its first session. {_MEASURED}")]
    last_measured_at: Annotated[datetime, Field(description=f"Of its last session. {_MEASURED}")]
    charted: Annotated[
        bool, Field(description="Whether there are five sessions, which a control chart takes.")
    ]
    sessions_between_false_alarms: Annotated[
        float | None,
        Field(
            description="Mean number of sessions between false alarms, all charts together; null: no chart."
        ),
    ]


class HistoryLimits(ResponseModel):
    """Control limits of a figure: individuals by three sigma, and those of the EWMA."""

    centre: Annotated[float, Field(description="Mean, of lengths the geometric one, in the figure's unit.")]
    low: Annotated[float, Field(description="Lower three-sigma limit by the mean moving range.")]
    high: Annotated[float, Field(description="Upper three-sigma limit by the mean moving range.")]
    ewma_limit: Annotated[
        float, Field(description="Limit on the size of the EWMA, in standard deviations of a session.")
    ]
    in_control: Annotated[
        bool,
        Field(description="Whether the last session lies within the limits and no lasting change is shown."),
    ]


class HistoryAlarm(ResponseModel):
    """A lasting change, shown by the EWMA or by a test for two levels."""

    direction: Annotated[ChangeDirection, Field(description="Which way the figure went.")]
    before: Annotated[float, Field(description="Mean level before the change, in the figure's unit.")]
    after: Annotated[float, Field(description="Mean level from the change on, up to where it was shown.")]
    since_session_id: Annotated[
        str, Field(description="Session from which on the level most likely is another.")
    ]
    since: Annotated[datetime, Field(description=f"When that session was measured. {_MEASURED}")]
    shown_by_session_id: Annotated[str, Field(description="Session that showed it.")]
    shown_at: Annotated[datetime, Field(description=f"When that session was measured. {_MEASURED}")]
    sentence: Annotated[
        str, Field(description="The same in words, with the events noted just before the change.")
    ]


class HistorySeries(ResponseModel):
    """A figure of a test over its sessions."""

    test: Annotated[int, Field(description=_TEST)]
    of: FigureOf
    figure: FigureName
    unit: FigureUnit
    sessions: Annotated[int, Field(description="Sessions that have it.")]
    first: Annotated[float, Field(description="Its value in the first of them.")]
    last: Annotated[float, Field(description="Its value in the last of them.")]
    last_session_id: Annotated[str, Field(description="The last of them.")]
    last_deviation: Annotated[
        float | None,
        Field(
            description="Of the last one: the identified parameter less the data sheet's; null: not stated."
        ),
    ]
    limits: Annotated[
        HistoryLimits | None, Field(description="Control limits; null: fewer than five sessions.")
    ]
    alarm: Annotated[HistoryAlarm | None, Field(description="The first lasting change; null: none is shown.")]


class HistoryEventRead(ResponseModel):
    """Something done to the robot."""

    event_id: Annotated[str, Field(description="Id of the event.")]
    at: Annotated[datetime, Field(description="When it was done, RFC 3339 in UTC.")]
    note: Annotated[str, Field(description="What was done.")]
    restarts_charts: Annotated[bool, Field(description="Whether charts begin anew with it.")]


class HistoryFigure(ResponseModel):
    """A figure of one session."""

    test: Annotated[int, Field(description=_TEST)]
    of: FigureOf
    figure: FigureName
    measured_at: Annotated[datetime, Field(description=_MEASURED)]
    session_id: SessionId
    session_name: SessionName
    report_id: Annotated[
        str | None, Field(description="Id of the report that has it; null of a qualification.")
    ]
    qualification_id: Annotated[
        str | None, Field(description="Id of the qualification that has it; null of a report.")
    ]
    value: Annotated[float, Field(description="The figure, in its unit.")]
    low: Annotated[float | None, Field(description="Lower end of its 95 % interval; null: not stated.")]
    high: Annotated[float | None, Field(description="Upper end of its 95 % interval; null: not stated.")]
    unit: FigureUnit
    deviation: Annotated[
        float | None,
        Field(description="The identified parameter less the data sheet's at that time; null: not stated."),
    ]
    ewma: Annotated[
        float | None, Field(description="The EWMA of self-starting scores; null: no chart, or no score yet.")
    ]
    outside: Annotated[bool, Field(description="Whether it lies outside the three-sigma limits.")]
    alarm_mark: Annotated[
        AlarmMark | None,
        Field(description="`since`: the level is another from here on. `shown`: here that was shown."),
    ]


class RobotHistory(ResponseModel):
    """A robot over its sessions, from stored reports; like is charted with like alone."""

    robot_id: RobotId
    robot_name: Annotated[str, Field(description="What people call the robot.")]
    sessions: Annotated[int, Field(description="Sessions in it.")]
    tests: Annotated[list[HistoryTest], Field(description="Sessions that are comparable, in time order.")]
    series: Annotated[list[HistorySeries], Field(description="Each figure of each test with its limits.")]
    events: Annotated[list[HistoryEventRead], Field(description="What was done to the robot, in time order.")]
    session_figures: Annotated[
        list[HistoryFigure], Field(description="Each figure of each session, in time order within a figure.")
    ]
    warnings: Annotated[
        list[AdvisoryRead],
        Field(description="What is missing, and why: reports that cannot be read, or are not read yet."),
    ]


class ComparedReport(ResponseModel):
    """One of two reports that are compared."""

    report_id: Annotated[str, Field(description="Id of the report.")]
    kind: Annotated[ReportKind, Field(description="What it is on.")]
    session_id: SessionId
    session_name: SessionName
    robot_id: Annotated[str | None, Field(description="The robot that it states; null: none.")]
    measured_at: Annotated[datetime, Field(description=_MEASURED)]


class ComparedFigure(ResponseModel):
    """A figure of the later report compared with the earlier one's."""

    of: Annotated[str, Field(description="What it is of: a pose, a joint, a camera.")]
    figure: Annotated[str, Field(description="Its name: `RP_l`, `AP_p`, or a parameter.")]
    unit: FigureUnit
    earlier_value: Annotated[float, Field(description="Its value in the earlier report.")]
    later_value: Annotated[float, Field(description="Its value in the later report.")]
    difference: Annotated[float, Field(description="Later less earlier, in its unit.")]
    difference_interval: Annotated[
        list[float], _INTERVAL, Field(description="95 % interval of the difference.")
    ]
    ratio: Annotated[float | None, Field(description="Later over earlier; null for what is no length.")]
    ratio_interval: Annotated[
        Annotated[list[float], _INTERVAL] | None, Field(description="95 % interval of the ratio.")
    ]
    change: Annotated[
        FigureChange,
        Field(
            description="What the interval shows: of the ratio where there is one, else of the difference."
        ),
    ]


class ReportComparison(ResponseModel):
    """Two reports compared figure by figure, with a conclusion in words."""

    earlier: Annotated[ComparedReport, Field(description="The report whose session was measured first.")]
    later: Annotated[ComparedReport, Field(description="The other one.")]
    comparable: Annotated[
        bool, Field(description="Whether a change of a figure is the robot's: like with like.")
    ]
    reasons: Annotated[list[str], Field(description="In what they are not comparable; empty: they are.")]
    not_stated: Annotated[
        list[str],
        Field(description="Conditions that either does not state: whether they were the same is not known."),
    ]
    change_shown: Annotated[
        bool,
        Field(description="Whether more figures differ, or one differs by more, than chance gives."),
    ]
    conclusion: Annotated[str, Field(description="What they show, in words.")]
    compared: Annotated[int, Field(description="Figures compared.")]
    changed: Annotated[int, Field(description="Of them, those whose intervals do not contain no change.")]
    expected_by_chance: Annotated[float, Field(description="How many that would be by chance alone.")]
    compared_figures: Annotated[
        list[ComparedFigure], Field(description="Figures that both have with an interval.")
    ]
