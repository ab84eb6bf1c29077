"""The plan of a test by ISO 9283, and its files."""

from app.analyses.documents.iso9283.forms import PLAN_WRITERS
from app.analyses.documents.iso9283.plan import TestRequest, plan_test
from app.analyses.documents.iso9283.runs import PlanRefused, sentences

__all__ = ["PLAN_WRITERS", "PlanRefused", "TestRequest", "plan_test", "sentences"]
