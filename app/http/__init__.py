"""What the API and the dashboard share of HTTP: who asks, what they may do, which status an error has."""

from app.http.access import GRANTS, authorize, holds
from app.http.invalid_fields import invalid_request
from app.http.request_headers import UNSAFE, check_headers
from app.http.requester import ClientDisconnected, RequesterDep, get_requester, key_of, run_while_connected
from app.http.sign_in import COOKIE, CSRF_HEADER, LASTS_S, SignIn, begin_sign_in, csrf_token, read_sign_in
from app.http.statuses import TITLES, status_of

__all__ = [
    "COOKIE",
    "CSRF_HEADER",
    "GRANTS",
    "LASTS_S",
    "TITLES",
    "UNSAFE",
    "ClientDisconnected",
    "RequesterDep",
    "SignIn",
    "authorize",
    "begin_sign_in",
    "check_headers",
    "csrf_token",
    "get_requester",
    "holds",
    "invalid_request",
    "key_of",
    "read_sign_in",
    "run_while_connected",
    "status_of",
]
