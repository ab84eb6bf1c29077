"""The document about repeatability: its table, the steadiness of the cycles, and the budgets."""

from app.analyses.documents.repeatability.drift import visit_hours
from app.analyses.documents.repeatability.table import repeatability_findings

__all__ = ["repeatability_findings", "visit_hours"]
