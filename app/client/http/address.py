"""The address of a service, and why a TLS connection to it cannot be made."""

from __future__ import annotations

import ssl

import httpx2

from .errors import ArgumentRefused

_LAST_PORT = 65535
_INTERFACE = "/v1"
_EXAMPLE = "Write it as http://measuring-pc:8000."
_NO_TLS = frozenset(
    {"WRONG_VERSION_NUMBER", "HTTP_REQUEST", "PACKET_LENGTH_TOO_LONG", "RECORD_LAYER_FAILURE"}
)
"""Reasons that OpenSSL gives where the other side answers in plain HTTP."""


def service_address(url: str) -> str:
    """Return the address of a service without what follows it: a slash, or /v1, which paths of requests have.

    Raises ArgumentRefused `invalid_url`.
    """
    address = url.strip().rstrip("/")
    address = address.removesuffix(_INTERFACE).rstrip("/")
    try:
        parsed = httpx2.URL(address)
    except httpx2.InvalidURL as error:
        raise _invalid(url, str(error).rstrip(".")) from error
    if "://" not in url:
        raise _invalid(url, "http:// or https:// is missing", f"Write it as http://{address.lstrip('/')}.")
    if parsed.scheme not in ("http", "https"):
        raise _invalid(url, f"it begins with {parsed.scheme}:// in place of http:// or https://")
    if not parsed.host:
        raise _invalid(url, "the name of the computer is missing")
    if parsed.port is not None and parsed.port > _LAST_PORT:
        raise _invalid(url, f"there is no port {parsed.port}")
    return address


def tls_failure(error: BaseException) -> ssl.SSLError | None:
    """Return the failure of TLS that caused an error and that would come again, or None."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, ssl.SSLCertVerificationError) or (
            isinstance(cause, ssl.SSLError) and cause.reason in _NO_TLS
        ):
            return cause
        cause = cause.__cause__ or cause.__context__
    return None


def advice_on_tls(url: str, failure: ssl.SSLError) -> str:
    """Return what to do about a failure of TLS that comes again."""
    if isinstance(failure, ssl.SSLCertVerificationError):
        return (
            "Check the name in the URL; a certificate of your own authority is given by SSL_CERT_FILE=FILE."
        )
    plain = url.replace("https://", "http://", 1)
    return f"The service does not seem to speak https there. Write the URL as {plain}."


def _invalid(url: str, reason: str, advice: str = _EXAMPLE) -> ArgumentRefused:
    return ArgumentRefused("invalid_url", f"{url} is not an address of a service: {reason}.", advice)
