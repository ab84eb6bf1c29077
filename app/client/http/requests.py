"""HTTP requests to the service, with retries: answers as dictionaries, refusals as `ClientError`.

Idempotent requests (GET, PUT by hash, the query for missing images) are repeated with growing pauses while the network
or the service is down. A POST that creates is repeated only where the service cannot have received it: the connection
was refused, or the answer was that the service is busy.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import timedelta
from typing import Any

import httpx2
import stamina

from ..closing import Closing
from .address import advice_on_tls, service_address, tls_failure
from .errors import ArgumentRefused, ClientError

Json = dict[str, Any]

_BUSY_STATUSES = frozenset({408, 425, 429, 502, 503, 504, 507})
_UNAUTHORIZED = 401
_PAGE, _MISSING_CHUNK = 500, 1000


class _BusyError(Exception):
    """A busy answer: the response, and the pause it asks for in seconds, at most 60."""

    def __init__(self, response: httpx2.Response) -> None:
        super().__init__(f"HTTP {response.status_code}")
        self.response = response
        pause_s = _pause_s(response)
        self.pause_s = min(pause_s, 60.0) if pause_s is not None else None


def insisting_query(accept_implausible: bool) -> str:
    """Return what is added to a path so that values are stored that look like another unit."""
    return "?accept_implausible=true" if accept_implausible else ""


def _encoded(body: Any) -> bytes:
    try:
        return json.dumps(body, allow_nan=False).encode()
    except (TypeError, ValueError, RecursionError) as error:
        raise ClientError(
            "invalid_request",
            f"Some values cannot be sent as JSON: {error}.",
            "NaN, infinities, dates and self-referring values are not allowed; write numbers and strings.",
        ) from error


class ServiceClient(Closing):
    """A connection to one service with one key; safe to use from several threads.

    Parameters
    ----------
    url, key
        Address of the service, and an API key (None for a service run with GRIDPOSE_AUTH=off).
    retry_for_s
        How long a request is repeated while the service is down or busy; 0 sends it once.
    on_retry
        Called with a short reason before each pause.

    Raises
    ------
    ArgumentRefused
        `invalid_url` or `invalid_key`.
    """

    def __init__(
        self,
        url: str,
        key: str | None,
        *,
        retry_for_s: float = 300.0,
        on_retry: Callable[[str], None] | None = None,
        transport: httpx2.BaseTransport | None = None,
    ) -> None:
        headers = {} if key is None else {"Authorization": f"Bearer {key}"}
        self.url = service_address(url)
        self._retry_for = timedelta(seconds=retry_for_s)
        self._on_retry = on_retry
        try:
            self._http = httpx2.Client(
                base_url=self.url,
                headers=headers,
                timeout=httpx2.Timeout(60.0, connect=10.0),
                transport=transport,
            )
        except UnicodeEncodeError as error:
            raise ArgumentRefused(
                "invalid_key",
                "The key holds characters that no API key has.",
                "Copy it again: gp_, the key's id, and the secret, as `gridpose keys create` printed them.",
            ) from error

    def close(self) -> None:
        self._http.close()

    def get(self, path: str, **query: Any) -> Json:
        return self._json("GET", path, repeatable=True, params=_without_nulls(query))

    def get_bytes(self, path: str, *, accept: str | None = None, **query: Any) -> bytes:
        """GET a file, or with `accept` an answer in another form than JSON."""
        options = {} if accept is None else {"headers": {"Accept": accept}}
        return self._request("GET", path, repeatable=True, params=_without_nulls(query), **options).content

    def create(self, path: str, body: Json) -> Json:
        """POST a new resource."""
        return self._json("POST", path, repeatable=False, json=body)

    def put(self, path: str, body: Json) -> Json:
        return self._json("PUT", path, repeatable=True, json=body)

    def items(self, path: str, **query: Any) -> Iterator[Json]:
        """Yield every item of a list, page by page, oldest first."""
        cursor: str | None = None
        while True:
            page = self.get(path, limit=_PAGE, cursor=cursor, **query)
            yield from page["items"]
            cursor = page["next_cursor"]
            if cursor is None:
                return

    def change(self, path: str, body: Json, **query: Any) -> Json:
        """PATCH a resource."""
        return self._json("PATCH", path, repeatable=True, json=body, params=_without_nulls(query))

    def delete(self, path: str, **query: Any) -> Json | None:
        """DELETE resources and return what the service answers, None for nothing."""
        response = self._request("DELETE", path, repeatable=False, params=_without_nulls(query))
        answer: Json | None = response.json() if response.content else None
        return answer

    def missing_images(
        self, session_id: str, images: Sequence[tuple[str, str]], *, target_id: str | None = None
    ) -> set[tuple[str, str]]:
        """Return the (pose_id, sha256) of which the session has no measurement of this target yet; always ask."""
        path = f"/v1/sessions/{session_id}/images/missing"
        missing: set[tuple[str, str]] = set()
        for start in range(0, max(len(images), 1), _MISSING_CHUNK):
            asked = [
                _without_nulls({"pose_id": pose, "sha256": sha256, "target_id": target_id})
                for pose, sha256 in images[start : start + _MISSING_CHUNK]
            ]
            answer = self._json("POST", path, repeatable=True, json={"images": asked})
            missing.update((entry["pose_id"], entry["sha256"]) for entry in answer["missing"])
        return missing

    def put_measured_poses(
        self, session_id: str, poses: Sequence[Json], *, accept_implausible: bool = False
    ) -> Json:
        """Store poses that another instrument measured; those stored stay. What looks like another unit is refused."""
        path = f"/v1/sessions/{session_id}/measured-poses{insisting_query(accept_implausible)}"
        return self._json("POST", path, repeatable=True, json=list(poses))

    def put_poses(self, session_id: str, poses: Sequence[Json], *, accept_implausible: bool = False) -> Json:
        """Store commanded poses, new or replaced: all or none. The service refuses what looks like another unit."""
        path = f"/v1/sessions/{session_id}/poses{insisting_query(accept_implausible)}"
        return self._json("POST", path, repeatable=True, json=list(poses))

    def put_image(self, session_id: str, pose_id: str, sha256: str, data: bytes, **metadata: Any) -> Json:
        """Upload one image and return its measurement; a repeated upload returns the existing one."""
        return self._json(
            "PUT",
            f"/v1/sessions/{session_id}/poses/{pose_id}/images/{sha256}",
            repeatable=True,
            params=_without_nulls(metadata),
            content=data,
            headers={"Content-Type": "application/octet-stream"},
        )

    def _json(self, method: str, path: str, *, repeatable: bool, **options: Any) -> Json:
        if "json" in options:
            options["content"] = _encoded(options.pop("json"))
            options["headers"] = {"Content-Type": "application/json"}
        response = self._request(method, path, repeatable=repeatable, **options)
        try:
            answer = response.json()
        except ValueError:
            answer = None
        if not isinstance(answer, dict):
            raise ClientError(
                "unexpected_answer",
                f"{self.url} answered {response.status_code} with something that is not this service's JSON.",
                "Check the URL: it must be that of a Gridpose service, without a path.",
                response.status_code,
            )
        return answer

    def _request(self, method: str, path: str, *, repeatable: bool, **options: Any) -> httpx2.Response:
        def should_retry(error: Exception) -> bool | float:
            if isinstance(error, _BusyError):
                again: bool | float = True if error.pause_s is None else error.pause_s
            elif isinstance(error, httpx2.UnsupportedProtocol | httpx2.LocalProtocolError):
                again = False  # caused by the request itself: it would fail again
            elif tls_failure(error) is not None:
                again = False
            else:
                sent = not isinstance(error, httpx2.ConnectError | httpx2.ConnectTimeout)
                again = isinstance(error, httpx2.TransportError) and (repeatable or not sent)
            if again is not False and self._on_retry is not None:
                self._on_retry(_reason(error))
            return again

        response: httpx2.Response | None = None
        try:
            for attempt in stamina.retry_context(
                on=should_retry,
                attempts=1 if not self._retry_for else None,
                timeout=self._retry_for or None,
                wait_initial=0.2,
                wait_max=15.0,
            ):
                with attempt:
                    response = self._http.request(method, path, **options)
                    # A longer pause, as an exhausted daily quota asks for, is not waited for.
                    is_short = timedelta(seconds=_pause_s(response) or 0.0) <= self._retry_for
                    if response.status_code in _BUSY_STATUSES and is_short:
                        raise _BusyError(response)
        except _BusyError as busy:
            response = busy.response
        except (httpx2.TransportError, httpx2.InvalidURL) as error:
            failure = tls_failure(error)
            raise ClientError(
                "unreachable",
                f"No answer from {self.url}: {_reason(error)}.",
                "Check the URL, the network, and that the service runs (`gridpose serve`)."
                if failure is None
                else advice_on_tls(self.url, failure),
            ) from error
        assert response is not None
        if response.is_success:
            return response
        refusal = _refusal(response)
        if refusal.status == _UNAUTHORIZED and "authorization" not in self._http.headers:
            ways = "or give the key by GRIDPOSE_KEY, GRIDPOSE_KEY_FILE or --api-key-file"
            refusal.advice = f"Sign in once with `gridpose login --url {self.url}`, {ways}."
        raise refusal


def _pause_s(response: httpx2.Response) -> float | None:
    """Return the pause that an answer asks for in seconds, or None."""
    text = response.headers.get("retry-after", "")
    return float(text) if text.isascii() and text.isdecimal() else None


def _refusal(response: httpx2.Response) -> ClientError:
    try:
        problem = response.json()
    except ValueError:
        problem = None
    status = response.status_code
    if isinstance(problem, dict) and "code" in problem:
        detail = str(problem.get("detail") or problem.get("title") or f"HTTP {status}")
        fields = [(str(e.get("field")), str(e.get("message"))) for e in problem.get("errors") or []]
        refusal = ClientError(str(problem["code"]), detail, problem.get("advice"), status, fields)
    else:
        refusal = ClientError("unexpected_answer", f"HTTP {status}.", status=status)
    refusal.retry_after_s = _pause_s(response)
    return refusal


def _reason(error: Exception) -> str:
    return str(error).rstrip(".") or type(error).__name__


def _without_nulls(query: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in query.items() if value is not None}
