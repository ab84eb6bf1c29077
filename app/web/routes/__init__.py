"""The pages, one module a noun."""

from app.web import static_files
from app.web.routes import (
    administration,
    camera,
    histories,
    measurements,
    planning,
    repeatability,
    reports,
    robots,
    sessions,
    sign_in,
    start,
    targets,
    uploads,
)

routers = (
    static_files.router,
    sign_in.router,
    start.router,
    uploads.router,
    sessions.router,
    measurements.router,
    repeatability.router,
    camera.router,
    robots.router,
    *planning.routers,
    histories.router,  # before reports, which take /reports/{report_id}
    reports.router,
    targets.router,
    administration.router,
    start.otherwise,  # last: it takes every address that is left
)
"""In the order in which an address is compared with them."""

__all__ = ["routers"]
