"""Figures along and about the axes, by their names in the analysis and as columns, and what verdicts say."""

from __future__ import annotations

AXES = ("x, mm", "y, mm", "z, mm", "roll, °", "pitch, °", "yaw, °")
"""Columns of what is stated along and about the axes."""
TURN_AXES = ("about x, °", "about y, °", "about z, °")
"""Columns of rotation vectors."""
RP_AXES = ("rp_x_mm", "rp_y_mm", "rp_z_mm", "rp_roll_deg", "rp_pitch_deg", "rp_yaw_deg")
AP_AXES = ("ap_x_mm", "ap_y_mm", "ap_z_mm", "ap_roll_deg", "ap_pitch_deg", "ap_yaw_deg")
VERDICTS = {
    "robot": "The figure is the robot's: the instrument adds about 3 % at most.",
    "instrument_limited": "The instrument adds more than about 3 % to the figure, or what it adds is not known: the "
    "robot is better than the figure. Use the corrected value where there is one.",
    "not_steady": "The cycles drift, jump, depend on one another or stop at two points: the figure depends on when and "
    "how long was measured. Remove the cause and measure again.",
    "below_detection": "The scatter is less than the stated noise alone would give: the stated uncertainties are too "
    "large.",
    "too_few_cycles": "A verdict takes ten cycles or more: the figure holds, its interval is wide. ISO 9283 asks for "
    "30.",
}
"""What verdicts say, on pages as in reports."""
