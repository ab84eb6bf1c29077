"""What the client repeats and what it does not: the real client, on a network that is a function."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator

import httpx2
import pytest
import stamina

from app.client import ClientError, ServiceClient

PROBLEM = {
    "type": "about:blank",
    "title": "No",
    "status": 422,
    "code": "hash_mismatch",
    "detail": "Other bytes.",
}


@pytest.fixture(autouse=True)
def without_pauses() -> Iterator[None]:
    with stamina.set_testing(True, attempts=5):
        yield


class Line:
    """A service that gives prepared answers in turn and keeps what it was asked."""

    def __init__(self, *answers: httpx2.Response | Exception) -> None:
        self.answers = list(answers)
        self.requests: list[httpx2.Request] = []

    def __call__(self, request: httpx2.Request) -> httpx2.Response:
        self.requests.append(request)
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def client(self, on_retry: Callable[[str], None] | None = None) -> ServiceClient:
        return ServiceClient(
            "http://cell:8000/", "gp_a_b", on_retry=on_retry, transport=httpx2.MockTransport(self)
        )


def test_an_upload_is_repeated_while_the_line_or_the_service_is_away() -> None:
    line = Line(
        httpx2.ConnectError("refused"),
        httpx2.ReadTimeout("slow"),
        httpx2.Response(503, json={}),
        httpx2.Response(507, headers={"retry-after": "2"}),
        httpx2.Response(202, json={"id": "m1"}),
    )
    reasons: list[str] = []
    with line.client(reasons.append) as client:
        assert client.put_image("s1", "P1", "ab", b"data", cycle=3)["id"] == "m1"
    assert len(line.requests) == 5
    assert len(reasons) == 4
    request = line.requests[-1]
    assert request.headers["authorization"] == "Bearer gp_a_b"
    assert str(request.url) == "http://cell:8000/v1/sessions/s1/poses/P1/images/ab?cycle=3"
    assert request.read() == b"data"


def test_a_creation_the_service_may_have_seen_is_not_repeated() -> None:
    line = Line(httpx2.ReadTimeout("slow"), httpx2.Response(201, json={}))
    with line.client() as client, pytest.raises(ClientError) as caught:
        client.create("/v1/sessions", {})
    assert caught.value.code == "unreachable"
    assert len(line.requests) == 1


def test_a_creation_that_nobody_heard_is_repeated() -> None:
    line = Line(httpx2.ConnectError("refused"), httpx2.Response(201, json={"id": "s"}))
    with line.client() as client:
        assert client.create("/v1/sessions", {})["id"] == "s"


def test_a_refusal_is_not_repeated_and_carries_the_problem() -> None:
    line = Line(
        httpx2.Response(422, json={**PROBLEM, "errors": [{"field": "cycle", "message": "too small"}]})
    )
    with line.client() as client, pytest.raises(ClientError) as caught:
        client.put_image("s1", "P1", "ab", b"data")
    assert (caught.value.code, caught.value.status) == ("hash_mismatch", 422)
    assert "cycle: too small" in caught.value.detail
    assert len(line.requests) == 1


@pytest.mark.parametrize("answer", [httpx2.Response(200, text="<html>"), httpx2.Response(404, text="nginx")])
def test_something_else_at_the_address_is_said_to_be_that(answer: httpx2.Response) -> None:
    with Line(answer).client() as client, pytest.raises(ClientError) as caught:
        client.get("/v1/sessions")
    assert caught.value.code == "unexpected_answer"


@pytest.mark.parametrize(
    ("url", "key", "code"),
    [
        ("http://[::1", "gp_a_b", "invalid_url"),
        ("http://cell:80800000", "gp_a_b", "invalid_url"),
        ("127.0.0.1:8801", "gp_a_b", "invalid_url"),
        ("measuring-pc:8000/v1", "gp_a_b", "invalid_url"),
        ("ftp://cell", "gp_a_b", "invalid_url"),
        ("http:///v1", "gp_a_b", "invalid_url"),
        ("http://cell:8000", "gp_schlüssel", "invalid_key"),
    ],
)
def test_an_address_or_a_key_that_cannot_be_is_said_to_be_that(url: str, key: str, code: str) -> None:
    with pytest.raises(ClientError) as caught:
        ServiceClient(url, key)
    assert caught.value.code == code
    assert caught.value.advice


@pytest.mark.parametrize(
    ("key", "advice"), [(None, "gridpose login --url http://cell"), ("gp_a_b", "Bearer")]
)
def test_who_sends_no_key_is_advised_how_to_give_one(key: str | None, advice: str) -> None:
    problem = {
        "code": "not_authenticated",
        "title": "No key",
        "advice": "Send it as `Authorization: Bearer KEY`.",
    }
    line = Line(httpx2.Response(401, json=problem))
    transport = httpx2.MockTransport(line)
    with (
        ServiceClient("http://cell", key, transport=transport) as client,
        pytest.raises(ClientError) as caught,
    ):
        client.get("/v1/sessions")
    assert advice in (caught.value.advice or "")


@pytest.mark.parametrize(
    "url", ["http://cell:8000", "http://cell:8000/", "http://cell:8000/v1", " http://cell:8000/v1/ "]
)
def test_an_address_may_end_with_that_of_the_interface(url: str) -> None:
    line = Line(httpx2.Response(200, json={}))
    with ServiceClient(url, "gp_a_b", transport=httpx2.MockTransport(line)) as client:
        client.get("/v1/sessions")
    assert str(line.requests[0].url) == "http://cell:8000/v1/sessions"


def test_https_where_the_service_speaks_http_is_not_repeated() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        answered = threading.Thread(target=answer_in_plain_http, args=(listener,))
        answered.start()
        reasons: list[str] = []
        url = f"https://127.0.0.1:{listener.getsockname()[1]}"
        with (
            ServiceClient(url, "gp_a_b", on_retry=reasons.append) as client,
            pytest.raises(ClientError) as caught,
        ):
            client.get("/v1/sessions")
        answered.join()
    assert (caught.value.code, reasons) == ("unreachable", [])
    assert "http://127.0.0.1" in (caught.value.advice or "")


def answer_in_plain_http(listener: socket.socket) -> None:
    connection, _ = listener.accept()
    with connection:
        connection.recv(4096)
        connection.sendall(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n")


def test_what_this_side_gets_wrong_is_not_repeated() -> None:
    line = Line(httpx2.LocalProtocolError("Illegal header value"), httpx2.Response(200, json={}))
    with line.client() as client, pytest.raises(ClientError, match="Illegal header value"):
        client.get("/v1/sessions")
    assert len(line.requests) == 1


def test_it_gives_up_in_the_end() -> None:
    with Line(*[httpx2.ConnectError("refused")] * 5).client() as client, pytest.raises(ClientError) as caught:
        client.get("/v1/sessions")
    assert caught.value.code == "unreachable"
    busy = [httpx2.Response(503, json={**PROBLEM, "code": "database_unavailable"}) for _ in range(5)]
    with Line(*busy).client() as client, pytest.raises(ClientError) as caught:
        client.get("/v1/sessions")
    assert caught.value.code == "database_unavailable"


def test_lists_are_read_page_by_page() -> None:
    line = Line(
        httpx2.Response(200, json={"items": [{"id": "a"}, {"id": "b"}], "next_cursor": "x"}),
        httpx2.Response(200, json={"items": [{"id": "c"}], "next_cursor": None}),
    )
    with line.client() as client:
        assert [item["id"] for item in client.items("/v1/sessions", status="queued")] == ["a", "b", "c"]
    assert line.requests[1].url.params["cursor"] == "x"
    assert line.requests[1].url.params["status"] == "queued"


def test_the_question_what_is_missing_is_cut_into_pieces() -> None:
    images = [("P1", f"{i:064x}") for i in range(1500)]
    pieces = [{"pose_id": "P1", "sha256": images[0][1]}], [{"pose_id": "P1", "sha256": images[-1][1]}]
    line = Line(*(httpx2.Response(200, json={"missing": piece}) for piece in pieces))
    with line.client() as client:
        assert client.missing_images("s1", images) == {images[0], images[-1]}
    assert len(line.requests) == 2
