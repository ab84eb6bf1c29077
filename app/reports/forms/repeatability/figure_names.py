"""Figures along and about the axes, by their names in the analysis and as columns, and what verdicts say."""

from __future__ import annotations

AXES = ("x, mm", "y, mm", "z, mm", "roll, °", "pitch, °", "yaw, °")
"""Columns of what is stated along and about the axes."""
RP_AXES = ("rp_x_mm", "rp_y_mm", "rp_z_mm", "rp_roll_deg", "rp_pitch_deg", "rp_yaw_deg")
AP_AXES = ("ap_x_mm", "ap_y_mm", "ap_z_mm", "ap_roll_deg", "ap_pitch_deg", "ap_yaw_deg")
VERDICTS = {
    "robot": "The reading is the robot's.",
    "instrument_limited": "The instrument's noise contributes to the reading.",
    "below_detection": "The reading is less than the instrument's noise alone would give.",
    "not_steady": "The cycles drift, jump, depend on one another or stop at two points.",
    "too_few_cycles": "A verdict takes ten cycles or more; ISO 9283 asks for 30.",
}
