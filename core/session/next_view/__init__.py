"""The most informative next camera poses: where another image would make camera, mount or robot most certain."""

from core.session.next_view.candidates import candidate_views
from core.session.next_view.information import camera_information, projection_jacobian
from core.session.next_view.robot_views import (
    NextRobotViews,
    suggest_dh_views,
    suggest_hand_eye_views,
    views_of_candidates,
)
from core.session.next_view.suggestion import suggest_views
from core.session.next_view.views_expected import common_fit

__all__ = [
    "NextRobotViews",
    "camera_information",
    "candidate_views",
    "common_fit",
    "projection_jacobian",
    "suggest_dh_views",
    "suggest_hand_eye_views",
    "suggest_views",
    "views_of_candidates",
]
