"""Which lens model a session's images ask for: Brown's, or one beyond it."""

from core.calibration.lens_selection.comparison import LensEvidence
from core.calibration.lens_selection.selection import LensChoice, select_lens
from core.calibration.lens_selection.starts import observed_radius_px

__all__ = [
    "LensChoice",
    "LensEvidence",
    "observed_radius_px",
    "select_lens",
]
