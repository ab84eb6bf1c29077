"""The dashboard: pages that people read, made on the server; what they change goes through the API.

A page calls the same services and analyses as the API, and asks `app.http` what the key allows. Forms and scripts send
changes to `/v1`, so that validation, scopes and audit have one set of rules.
"""

from app.web.refusals import PageRefusals
from app.web.routes import routers

__all__ = ["PageRefusals", "routers"]
