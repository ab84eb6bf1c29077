"""What the fit of one image by itself leaves for the fit of its pose's images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from core.calibration.residuals import View
from core.calibration.single_image import MIN_REFIT_INFLATION


@dataclass(frozen=True, slots=True)
class ImageFit:
    """One image by itself: its state, the points used, u(f)/f, its inflation, and whether it contradicts the lens."""

    state: View
    used: Bool[np.ndarray, " n"]
    focal_uncertainty: float
    inflation: float
    contradicts_lens: bool

    @property
    def prior_factor(self) -> float:
        """Return the weight of the priors in the fit."""
        return self.inflation if self.inflation >= MIN_REFIT_INFLATION else 1.0
