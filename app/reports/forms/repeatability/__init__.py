"""Sections of a report on repeatability, which every form draws.

`sections` puts them in order, `accuracy` has those on AP, AD, RD and vAP, `cycles` those on drift and steadiness,
`outliers` those on cycles that the others do not explain, `uncertainty_budget` what the uncertainties are made of.
`figure_names` names figures and verdicts.
"""

from app.reports.forms.repeatability.figure_names import AP_AXES, RP_AXES, VERDICTS
from app.reports.forms.repeatability.sections import headline, repeatability_blocks

__all__ = ["AP_AXES", "RP_AXES", "VERDICTS", "headline", "repeatability_blocks"]
