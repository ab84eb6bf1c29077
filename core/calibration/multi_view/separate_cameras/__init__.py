"""Views of a focus group that have a camera of their own each."""

from core.calibration.multi_view.separate_cameras.fits import fit_each

__all__ = ["fit_each"]
