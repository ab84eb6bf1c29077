"""Numbers to reach with single images: corners, time, photographs."""

from __future__ import annotations

from benchmarks.goals.goal import INDEPENDENT, Goal, Part, at_least, at_most

_SETS = r"(?!all:).*: "
"""Rows of one set of photographs."""
CORNERS = (
    Goal(
        "corner rms, 9×6 / 14×10 / 25×18, cluttered scenes",
        "≤ .006 / .007 / .010 px",
        (
            at_most("corners", "corner rms, 9x6", 0.006),
            at_most("corners", "corner rms, 14x10", 0.007),
            at_most("corners", "corner rms, 25x18", 0.010),
        ),
        INDEPENDENT,
    ),
    Goal(
        "corner rms ÷ cornerSubPix 11, 9×6 / 14×10 / 25×18",
        "≤ .14 / .16 / .20",
        (
            at_most("corners", "corner rms ÷ cornerSubPix 11, 9x6", 0.14),
            at_most("corners", "corner rms ÷ cornerSubPix 11, 14x10", 0.16),
            at_most("corners", "corner rms ÷ cornerSubPix 11, 25x18", 0.20),
        ),
        "ours are at the Cramér-Rao bound (next row): on these scenes no unbiased refiner has a lower ratio",
    ),
    Goal(
        "corner rms ÷ Cramér-Rao bound of the half-cell window",
        "≤ 1.15",
        (at_most("corners", "corner rms ÷ Cramér-Rao bound, .*", 1.15),),
    ),
)
SPEED = (
    Goal(
        "PNG bytes to pose ÷ cv2.imdecode, 14×10; 25×18",
        "≤ .6; ≤ .75",
        (
            at_most("pipeline", "PNG bytes to pose ÷ cv2.imdecode alone, 14x10", 0.6),
            at_most("pipeline", "PNG bytes to pose ÷ cv2.imdecode alone, 25x18", 0.75),
        ),
        INDEPENDENT,
    ),
    Goal(
        "JPEG q95 to pose ÷ decode, 14×10; 25×18",
        "≤ 1.4; ≤ 1.7",
        (
            at_most("pipeline", "JPEG bytes to pose ÷ cv2.imdecode alone, 14x10", 1.4),
            at_most("pipeline", "JPEG bytes to pose ÷ cv2.imdecode alone, 25x18", 1.7),
        ),
        INDEPENDENT,
    ),
    Goal(
        "naive recipe ÷ ours, mean over scenes",
        "≥ 5",
        (at_least("pipeline", "naive recipe ÷ ours, mean", 5),),
    ),
    Goal(
        "processor time of the service per upload of 25 kB ÷ bare reference, 0; 2 workers",
        "≤ 2; ≤ 2.5",
        (
            at_most("service", "the same ÷ the bare upload, 0 workers", 2.0),
            at_most("service", "the same ÷ the bare upload, 2 workers", 2.5),
        ),
    ),
    Goal(
        "HTTP images/s ÷ bare loop with as many processes, 40 ms images",
        "≥ .85",
        (at_least("service", "HTTP images/s ÷ bare loop with as many processes", 0.85),),
    ),
    Goal(
        "the same, 5 ms images ÷ bare loop alongside the bare reference",
        "≥ .85",
        (at_least("crowd", "small images: HTTP images/s ÷ bare loop alongside the bare reference", 0.85),),
    ),
    Goal(
        "acknowledgement of 3 MB ÷ (SHA-256 + write + fsync), p50; p90",
        "≤ 1.8; ≤ 2.5",
        (
            at_most("service", r"acknowledgement ÷ SHA-256 \+ write \+ fsync, median", 1.8),
            at_most("service", r"acknowledgement ÷ SHA-256 \+ write \+ fsync, p90", 2.5),
        ),
    ),
    Goal(
        "8 clients × 150 kB alongside two workers: images/s; ack p50, p99; ÷ hash + write + fsync alongside them",
        "≥ 60; ≤ 20, ≤ 60 ms; ≤ 20, ≤ 60",
        (
            at_least("crowd", "8 clients: images acknowledged", 60.0),
            at_most("crowd", "8 clients: acknowledgement, median", 20.0),
            at_most("crowd", "8 clients: acknowledgement, p99", 60.0),
            at_most("crowd", r"8 clients: acknowledgement ÷ SHA-256 \+ write \+ fsync, median", 20.0),
            at_most("crowd", r"8 clients: acknowledgement ÷ SHA-256 \+ write \+ fsync, p99", 60.0),
        ),
    ),
    Goal(
        "2 workers ÷ 1",
        "≥ 1.9",
        (at_least("service", "2 workers ÷ 1, by HTTP", 1.9),),
        "N worker machines: `--only scale` needs PostgreSQL, and cores of their own to say how it grows",
    ),
    Goal(
        "`make setup`; fresh clone to `make demo` finished",
        "≤ 50 s; ≤ 120 s",
        (
            at_most("clone", "fresh clone: make setup", 50.0),
            at_most("clone", "fresh clone to make demo finished", 120.0),
        ),
        "means an idle machine of two cores",
    ),
    Goal(
        "`make test` from a set-up clone; `make test-all`",
        "≤ 5 min; ≤ 20 min",
        (at_most("suite", "make test", 5.0), at_most("suite", "make test-all", 20.0)),
        "means an idle machine of two cores",
    ),
)
PHOTOGRAPHS = (
    Goal(
        "photographs with the board in view that get a calibration, each by itself",
        "≥ 95 %",
        (at_least("photographs", "photographs answered", 95.0),),
        "96 of the 115 photographs are here",
    ),
    Goal(
        "photographs that get a calibration with the lens of the session's other images",
        "≥ 95 %, intervals of f hold 90 to 98 %",
        (
            at_least("photographs", "per_image_session_prior: photographs answered", 95.0),
            Part("photographs", "per_image_session_prior: 95 % interval of f holds", 90.0, 98.0),
        ),
    ),
    Goal(
        "median relative error of f ÷ the naive one-view recipe, per set",
        "≤ 1 in all 9",
        (Part("photographs", _SETS + "median relative error of f", own=True),),
    ),
    Goal(
        "rms of (f - f_ref)/u, all photographs; per set; largest",
        ".9 to 1.1; ≤ 1.3; ≤ 3",
        (
            Part("photographs", r"all: rms of Δf/u\(f\)", 0.9, 1.1),
            at_most("photographs", _SETS + r"rms of Δf/u\(f\)", 1.3),
            at_most("photographs", r"all: largest error of f ÷ u\(f\)", 3.0),
        ),
    ),
    Goal(
        "pooled f against multi-view references",
        "≤ .5 % in all 9",
        (at_most("photographs", _SETS + "pooled f less OpenCV's, relative", 0.5),),
    ),
)
