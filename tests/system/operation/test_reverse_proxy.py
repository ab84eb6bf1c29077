"""docker/nginx.conf and docker/Caddyfile as they are: TLS, large bodies, events, clients' addresses, a restart."""

from __future__ import annotations

import hashlib
import os
import shutil
import socket
import ssl
import subprocess
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import pytest

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from tests.support.image.images import small_image
from tests.support.service.service import TARGET, new_session, wait_until

PROJECT = Path(__file__).parents[3]
NAME = "gridpose.example.com"
CLIENT_ADDRESS = "127.0.0.2"
"""Of the loopback network, as the proxy's 127.0.0.1 is, and not the same."""


@dataclass(frozen=True)
class Proxied:
    """A service on a port that stays the same over its restarts, and the proxy before it."""

    service: ServiceProcess
    key: str
    url: str
    tls: ssl.SSLContext

    def restart(self) -> None:
        assert self.service.stop() == 0
        self.service.start()

    def client(self, **options: Any) -> httpx2.Client:
        headers = {"Authorization": f"Bearer {self.key}", **options.pop("headers", {})}
        return httpx2.Client(base_url=self.url, verify=self.tls, headers=headers, timeout=60, **options)


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port: int = free.getsockname()[1]
    return port


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """One service behind all proxies, which computes nothing."""
    settings = {"GRIDPOSE_WORKERS": "0", "GRIDPOSE_TRUSTED_PROXIES": "127.0.0.1"}
    process = ServiceProcess(tmp_path_factory.mktemp("proxied") / "data", settings, port=free_port())
    with process:
        yield process


@pytest.fixture(params=["nginx", "caddy"])
def proxied(request: pytest.FixtureRequest, service: ServiceProcess, tmp_path: Path) -> Iterator[Proxied]:
    program: str = request.param
    found = shutil.which(program, path=f"{os.environ['PATH']}{os.pathsep}/usr/sbin")
    if found is None:
        if os.environ.get("CI"):
            pytest.fail(f"{program} is required here and not installed")
        pytest.skip(f"{program} is not installed")
    service_port, port = int(service.url.rpartition(":")[2]), free_port()
    key = service.admin_key
    assert key is not None
    certificate = make_certificate(tmp_path)
    command = [found, *arguments_of[program](tmp_path, service_port, port, certificate)]
    with (tmp_path / "proxy.log").open("wb") as log:
        proxy = subprocess.Popen(command, stdout=log, stderr=log, env={**os.environ, "HOME": str(tmp_path)})
    tls = ssl.create_default_context(cafile=str(certificate))
    url = f"https://localhost:{port}"

    def answers() -> bool:
        assert proxy.poll() is None, (tmp_path / "proxy.log").read_text(errors="replace")
        try:
            return httpx2.get(f"{url}/livez", verify=tls).status_code == 200
        except httpx2.TransportError:
            return False

    try:
        wait_until(answers, 120, f"{program} answers")
        yield Proxied(service, key, url, tls)
    finally:
        proxy.terminate()
        try:
            proxy.wait(60)
        finally:
            proxy.kill()
            proxy.wait()


def make_certificate(folder: Path) -> Path:
    """A certificate for localhost that signs itself, and its key in key.pem."""
    subprocess.run(
        [
            *(
                "openssl",
                "req",
                "-x509",
                "-newkey",
                "ec",
                "-pkeyopt",
                "ec_paramgen_curve:prime256v1",
                "-nodes",
            ),
            *("-keyout", str(folder / "key.pem"), "-out", str(folder / "certificate.pem"), "-days", "2"),
            *("-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost"),
        ],
        check=True,
        capture_output=True,
    )
    return folder / "certificate.pem"


def replaced(text: str, changes: dict[str, str]) -> str:
    for old, new in changes.items():
        assert old in text, f"the file has no {old!r}"
        text = text.replace(old, new)
    return text


def nginx(folder: Path, service_port: int, port: int, certificate: Path) -> list[str]:
    site = replaced(
        (PROJECT / "docker" / "nginx.conf").read_text(encoding="utf-8"),
        {
            "127.0.0.1:8000": f"127.0.0.1:{service_port}",
            "listen 443 ssl": f"listen 127.0.0.1:{port} ssl",
            NAME: "localhost",
            "/etc/ssl/gridpose/certificate.pem": str(certificate),
            "/etc/ssl/gridpose/key.pem": str(folder / "key.pem"),
        },
    )
    paths = "".join(
        f"{kind}_temp_path {folder}/{kind};\n"
        for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    )
    (folder / "nginx.conf").write_text(
        f"daemon off;\nmaster_process off;\npid {folder}/nginx.pid;\nerror_log stderr;\nevents {{}}\n"
        f"http {{\naccess_log off;\n{paths}{site}}}\n",
        encoding="utf-8",
    )
    return ["-p", str(folder), "-e", "stderr", "-c", str(folder / "nginx.conf")]


def caddy(folder: Path, service_port: int, port: int, certificate: Path) -> list[str]:
    site = replaced(
        (PROJECT / "docker" / "Caddyfile").read_text(encoding="utf-8"),
        {
            "127.0.0.1:8000": f"127.0.0.1:{service_port}",
            f"{NAME} {{": f"https://localhost:{port} {{\n\tbind 127.0.0.1\n\ttls {certificate} {folder}/key.pem\n",
        },
    )
    options = (
        "{\n\tadmin off\n\tauto_https disable_redirects\n\tskip_install_trust\n"
        f"\tstorage file_system {folder}/caddy\n}}\n"
    )
    (folder / "Caddyfile").write_text(options + site, encoding="utf-8")
    return ["run", "--adapter", "caddyfile", "--config", str(folder / "Caddyfile")]


arguments_of: dict[str, Callable[[Path, int, int, Path], list[str]]] = {"nginx": nginx, "caddy": caddy}


def test_a_service_behind_a_proxy_with_tls(proxied: Proxied) -> None:
    with ServiceClient(proxied.service.url, proxied.key) as client:
        session_id = new_session(client)
    uploads_path = f"/v1/sessions/{session_id}/poses/P1/images"

    with proxied.client() as http:
        # A body of the largest size: it has to reach the service whole to be refused for what it is.
        body = bytes(128 * 1024 * 1024)
        large = http.put(
            f"{uploads_path}/{hashlib.sha256(body).hexdigest()}",
            content=body,
            headers={"Content-Type": "application/octet-stream"},
        )
        assert (large.status_code, large.json()["code"]) == (415, "unsupported_image")
        too_large = http.put(
            f"{uploads_path}/{'0' * 64}",
            content=body + b"x",
            headers={"Content-Type": "application/octet-stream"},
        )
        assert (too_large.status_code, too_large.json()["code"]) == (413, "upload_too_large")
        form = http.post(
            f"/v1/sessions/{session_id}/images",
            files={"image": ("a.png", small_image(1), "image/png")},
            data={"pose_id": "P1"},
        )
        assert form.status_code == 202, form.text

    assert_events_flow(proxied, session_id, small_image(2))
    assert_the_trail_names_the_client(proxied)

    proxied.restart()
    with proxied.client() as http:
        again = http.put(
            f"{uploads_path}/{hashlib.sha256(small_image(3)).hexdigest()}",
            content=small_image(3),
            headers={"Content-Type": "application/octet-stream"},
        )
        assert again.status_code == 202, again.text
        counts = http.get(f"/v1/sessions/{session_id}").json()["counts"]
    assert sum(counts[status] for status in ("queued", "running", "succeeded", "failed")) == 3


def assert_the_trail_names_the_client(proxied: Proxied) -> None:
    """Send a change from an address that is not the proxy's, and with a forged one in the header."""
    transport = httpx2.HTTPTransport(verify=proxied.tls, local_address=CLIENT_ADDRESS)
    with proxied.client(transport=transport, headers={"X-Forwarded-For": "203.0.113.9"}) as http:
        made = http.post("/v1/targets", json=TARGET)
        assert made.status_code == 201, made.text
    with proxied.client() as http:
        entries = http.get("/v1/audit", params={"object_id": made.json()["id"]}).json()["items"]
    assert [(entry["action"], entry["client"]) for entry in entries] == [("create_target", CLIENT_ADDRESS)]


def assert_events_flow(proxied: Proxied, session_id: str, data: bytes) -> None:
    """Follow the session's events and upload once they flow.

    The stream has no end of its own: an event that waited in a buffer would not come at all.
    """
    first, news = threading.Event(), threading.Event()

    def follow() -> None:
        with proxied.client() as http, http.stream("GET", f"/v1/sessions/{session_id}/events") as events:
            for line in events.iter_lines():
                if line.startswith("data:"):
                    (news if first.is_set() else first).set()
                if news.is_set():
                    return

    follower = threading.Thread(target=follow, daemon=True)
    follower.start()
    assert first.wait(120), "the first event arrives while the stream is open"
    with proxied.client() as http:
        sent = http.put(
            f"/v1/sessions/{session_id}/poses/P1/images/{hashlib.sha256(data).hexdigest()}",
            content=data,
            headers={"Content-Type": "application/octet-stream"},
        )
    assert sent.status_code == 202, sent.text
    assert news.wait(120), "the upload's event arrives while the stream is open"
    follower.join(120)
    assert not follower.is_alive()
