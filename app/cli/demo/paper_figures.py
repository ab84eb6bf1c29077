"""What Boby and Saha printed (ICRA 2016): their Tables III and IV.

Their Table II is an image in the copy this was taken from, and its figures are not given here.
"""

from __future__ import annotations

POSES = ("P1", "P2", "P3", "P4", "P5")
PRINTED: dict[str, dict[str, tuple[float, ...]]] = {
    "proposed": {
        "rp_l_mm": (0.258, 0.157, 0.330, 0.218, 0.307),
        "rp_roll_deg": (0.014, 0.008, 0.007, 0.007, 0.008),
        "rp_pitch_deg": (0.026, 0.011, 0.016, 0.015, 0.023),
        "rp_yaw_deg": (0.017, 0.012, 0.018, 0.014, 0.018),
    },
    "ArUco": {
        "rp_l_mm": (0.386, 1.376, 1.764, 1.591, 0.862),
        "rp_roll_deg": (0.052, 0.061, 0.198, 0.030, 0.034),
        "rp_pitch_deg": (0.069, 0.357, 0.278, 0.456, 0.057),
        "rp_yaw_deg": (0.147, 0.226, 0.437, 0.181, 0.271),
    },
}
"""Repeatability of the KUKA KR5 Arc at five poses of a 100 mm cube, by their method and by ArUco."""
PRINTED_LINKS: dict[str, tuple[float, ...]] = {
    "a": (189.6, 759.4, 105.9, 271.5, 30.1),
    "alpha": (77.6, 2.4, 94.9, 94.2, 90.9),
    "d": (0.0, 0.0, 173.7, 44.0, 9.2),
}
"""Table IV: link lengths (mm), twists (°) and joint offsets (their b, mm) of links 1 to 5, by circle point analysis."""
