"""Documents about a robot's kinematics: what was identified, and plans of poses."""

from app.analyses.documents.dh.compensation import compensation_findings
from app.analyses.documents.dh.error_map import error_map_findings, error_map_of
from app.analyses.documents.dh.error_model import level_document
from app.analyses.documents.dh.identification import dh_findings, identified
from app.analyses.documents.dh.plan import check_plan_size, plan_document

__all__ = [
    "check_plan_size",
    "compensation_findings",
    "dh_findings",
    "error_map_findings",
    "error_map_of",
    "identified",
    "level_document",
    "plan_document",
]
