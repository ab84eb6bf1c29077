"""Numbers to reach with robots: repeatability, and what identifies an arm."""

from __future__ import annotations

from benchmarks.goals.goal import INDEPENDENT, Goal, Part, at_least, at_most

REPEATABILITY = (
    Goal(
        "RP_l floor, pooled; orientation",
        "≤ .005 mm; ≤ .0005°",
        (
            at_most("metrology", "RP_l floor, pooled, board 40-75 % of the width", 0.005),
            at_most("metrology", "3 S floor of the worst angle, pooled, board 40-75 % of the width", 0.0005),
        ),
        INDEPENDENT,
    ),
    Goal(
        "verdict `robot` where nothing moved, disturbances included",
        "0",
        (at_most("trust", "(sessions with a )?verdict robot where nothing moved", 0.0),),
    ),
    Goal(
        "reported AP ÷ true AP, rms; coverage of its interval",
        ".95 to 1.1; 95 ± 3 %",
        (
            Part("trust", "AP: .*reported ÷ true, rms", 0.95, 1.1),
            Part("trust", "AP: .*coverage of AP_p", 92.0, 98.0),
        ),
    ),
    Goal(
        "floor predicted ÷ true with correlated noise, waves, bursts",
        ".9 to 1.15",
        (Part("trust", "floor stated ÷ read, .*", 0.9, 1.15),),
        "a wave of one amplitude in all images scatters as stated (rms 1.02), but its lengths hardly "
        "vary: RP_l reads less than that of Gaussian noise of the same size",
    ),
    Goal(
        "power of `robot` less that with the floor known",
        "within .1",
        (Part("trust", "power of robot less that with the floor known, .*", -0.1, 0.1),),
    ),
    Goal(
        "`not_steady`: false alarms per session; power",
        "≤ 2 %; ≥ .98",
        (
            at_most("trust", "`not_steady` per session of steady cycles, .*", 2.0),
            at_least("trust", "`not_steady`, .*", 0.98),
        ),
    ),
    Goal(
        "coverage of the interval of RP_l: AR(1) .3 and .8, Student t4, 30 and 10 cycles",
        "93 to 97 %",
        (Part("trust", r"coverage of 95 % intervals of RP_l, (AR|Student).*", 93.0, 97.0),),
    ),
    Goal(
        "coverage of stated 95 % intervals, single images: mean; lowest and highest parameter",
        "95 ± 2 %",
        (
            Part("fit", "coverage of 95 % intervals, mean", 93.0, 97.0),
            Part("fit", "coverage, (lowest|highest) parameter .*", 93.0, 97.0),
        ),
    ),
    Goal(
        "the same of RP; AP; AD; DH",
        "95 ± 2 %",
        (
            Part("metrology", "coverage of 95 % intervals.*", 93.0, 97.0),
            Part("trust", "AP: .*coverage of AP_p", 93.0, 97.0),
            Part("trust", "shape: perfect.*: coverage of AD", 93.0, 97.0),
            Part("kinematics", "coverage of 95 % intervals of DH, .*", 93.0, 97.0),
        ),
        "AD from five poses of one orientation: the priors of the print dominate, the interval is too "
        "wide; an oracle with them states as much (section trust)",
    ),
    Goal(
        "coverage under departures: single images; print; gears and compliance",
        "≥ 85 %, or a warning says why not",
        (
            at_least("departures", ".*: holds, or a warning says why not", 85.0),
            at_least("trust", "shape: .*: coverage of .*", 85.0),
            at_least("trust", "gears and compliance, .*: DH within 95 % intervals", 85.0),
        ),
    ),
)
ARMS = (
    Goal(
        "DH rms from rendered images, perfect robot",
        "≤ .002 mm / .0001°",
        (
            at_most("kinematics", "DH rms from rendered images, perfect robot, lengths", 0.002),
            at_most("kinematics", "DH rms from rendered images, perfect robot, angles", 0.0001),
        ),
    ),
    Goal(
        "UR10: rms z of DH between halves by elbow, height, time",
        "≤ 1.5 in every series",
        (at_most("trust", "UR10 .*: rms z of DH between halves by (elbow|height|time)", 1.5),),
        "series B; A, C and D are not here",
    ),
    Goal(
        "UR10: held-out position error ÷ nominal, random; by joint-space clusters",
        "≤ .13; ≤ .2",
        (
            at_most("trust", "UR10 .*: held-out position error ÷ nominal, random folds", 0.13),
            at_most("trust", "UR10 .*: held-out position error ÷ nominal, clusters of joint space", 0.2),
        ),
        "series B; A, C and D are not here",
    ),
    Goal(
        "other arms, 60 poses or more: error of the chosen level ÷ DH's",
        "never over 1.02",
        (at_most("trust", ".*(60|120) poses: true position error of auto ÷ that of dh", 1.02),),
        "simulated arms; of real ones only the FANUC R-2000iC is here, with 24 poses: neither this nor rms z between "
        "halves (≤ 1.7) can be measured",
    ),
    Goal(
        "next views: images that the suggested order needs ÷ a random order, intrinsics; hand-eye; DH",
        "≤ .6",
        (at_most("next_view", "next view, (intrinsics|hand-eye|DH): images ÷ random order, mean", 0.6),),
        "hand-eye: of the same views no choice needs fewer than .61 (section next_view, least images of any choice)",
    ),
    Goal(
        "coverage of the predicted position at left-out blocks",
        "≥ 90 %",
        (at_least("trust", "UR10 .*: coverage of the predicted position at held-out blocks .*", 90.0),),
        "series B; A, C and D are not here",
    ),
)
