"""The most informative next camera poses: where another image would make the camera most certain."""

from core.session.next_view.candidates import candidate_views
from core.session.next_view.information import camera_information, projection_jacobian
from core.session.next_view.suggestion import NextViews, suggest_views

__all__ = ["NextViews", "camera_information", "candidate_views", "projection_jacobian", "suggest_views"]
