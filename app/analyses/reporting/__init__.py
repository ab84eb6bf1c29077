"""Stored reports: made in a process of the analyses from what a session holds, and verified by computing anew.

`ReportMaker` takes queued reports in the process that serves; everything that loads the numerics runs alongside it.
"""

from app.analyses.reporting.maker import ReportMaker
from app.analyses.reporting.orders import DH_DEFAULTS, VerificationOrder
from app.analyses.reporting.requests import verification

__all__ = [
    "DH_DEFAULTS",
    "ReportMaker",
    "VerificationOrder",
    "verification",
]
