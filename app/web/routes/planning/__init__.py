"""What to do next: views that help a camera most, repeatability elsewhere, poses for an identification or a test."""

from app.web.routes.planning import iso9283, robot_plan, session_advice
from app.web.routes.planning.session_advice import known_targets

routers = (iso9283.router, session_advice.router, robot_plan.router)

__all__ = ["known_targets", "routers"]
