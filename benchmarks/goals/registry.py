"""Every number to reach, in the order in which a user meets them, with the rows that measure it."""

from __future__ import annotations

from benchmarks.goals.goal import Goal, at_most
from benchmarks.goals.images import CORNERS, PHOTOGRAPHS, SPEED
from benchmarks.goals.robots import ARMS, REPEATABILITY

_OPERATION = (
    Goal(
        "acknowledged uploads lost over ≥ 20 kill -9",
        "0",
        (at_most("durability", "acknowledged uploads lost over 20 kill -9", 0.0),),
    ),
    Goal(
        "growth of the service's memory on any single hostile upload",
        "≤ 64 MiB",
        (at_most("durability", "growth of the service's memory, hostile upload, .*", 64.0),),
    ),
    Goal(
        "repeatability over 10,000 stored measurements; page of 50",
        "≤ .7 s; ≤ 8 ms",
        (
            at_most("analyses", "repeatability over 10,000 stored measurements", 0.7),
            at_most("analyses", "a page of 50 of 10,000 measurements", 8.0),
        ),
    ),
    Goal(
        "repeatability of 150 images; identification of 3,000 poses: time; memory",
        "≤ 1.5 s; ≤ 6 s; ≤ 500 MiB",
        (
            at_most("plain_sessions", "repeatability of 150 images", 1.5),
            at_most("plain_sessions", "identification of 3,000 poses: .*", 6.0),
            at_most("plain_sessions", "memory of an identification of 3,000 poses: .*", 500.0),
        ),
    ),
    Goal(
        "history of a robot over 1,000 sessions; PDF of a 5 × 30 session; verification of 150 images ÷ computation",
        "≤ 200 ms; ≤ 1 s; ≤ 1.3",
        (
            at_most("reports", "history of a robot over 1,000 sessions", 200.0),
            at_most("reports", "forms of a report, PDF among them", 1.0),
            at_most("reports", "verification of a report ÷ computation of its images", 1.3),
        ),
    ),
    Goal(
        "dashboard: server time of the first page; of a session of 10,000 images; until they answer to their reader",
        "≤ 150 ms; ≤ 300 ms; ≤ 1 s",
        (
            at_most("browser", "first page: until the first byte", 150.0),
            at_most("browser", "session of 10,000 images: until the first byte", 300.0),
            at_most("browser", ".*: until it answers to its reader", 1000.0),
        ),
    ),
    Goal(
        "dashboard: thumbnail, warm; live update after a result",
        "≤ 15 ms; ≤ 1 s",
        (
            at_most("browser", "thumbnail, warm", 15.0),
            at_most("browser", "live update after a result", 1.0),
        ),
    ),
    Goal(
        "dashboard: workers slower by an open live page",
        "≤ 5 %",
        (at_most("browser", "workers slower by an open live page", 5.0),),
    ),
    Goal(
        "memory of one worker at 20 Mpx",
        "≤ 250 MiB",
        (at_most("decoding", "memory of one worker at 20 Mpx, .*", 250.0),),
    ),
)

GOALS = (*CORNERS, *SPEED, *PHOTOGRAPHS, *REPEATABILITY, *ARMS, *_OPERATION)
