"""Receivers of webhooks that do not answer, and those whose certificate nobody knows."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from app.delivery import posting
from tests.support.service.receiver import receiver
from tests.support.service.service import Api, wait_until


def made(api: Api, url: str) -> str:
    webhook = {"name": "MES", "url": url, "types": ["report.ready"]}
    webhook_id: str = api.client.post("/v1/webhooks", json=webhook).raise_for_status().json()["id"]
    return webhook_id


def send_test(api: Api, webhook_id: str) -> str:
    delivery_id: str = api.client.post(f"/v1/webhooks/{webhook_id}/test").raise_for_status().json()["id"]
    return delivery_id


def delivery(api: Api, webhook_id: str, delivery_id: str) -> dict[str, Any]:
    items = api.client.get(f"/v1/webhooks/{webhook_id}/deliveries").raise_for_status().json()["items"]
    (found,) = (one for one in items if one["id"] == delivery_id)
    return dict(found)


def test_one_that_never_answers_delays_no_other(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    """Others waited for the end of its attempt, 15 s, with each of theirs."""
    monkeypatch.setattr(posting, "WITHIN_S", 3600.0)
    with receiver() as silent, receiver() as good:
        silent.answers.clear()
        unanswered = made(api, silent.url)
        waiting = [send_test(api, unanswered) for _ in range(2)]
        wait_until(lambda: silent.received != [], 120.0, "the silent one has its first notice")
        other = made(api, good.url)
        for count in range(1, 3):
            send_test(api, other)
            wait_until(lambda: len(good.received) == count, 120.0, "the other is notified")  # noqa: B023
        assert [delivery(api, unanswered, one)["attempts"] for one in waiting] == [1, 0], "one after another"
        silent.answers.set()
        wait_until(lambda: len(silent.received) == 2, 120.0, "it goes on where it answers")


def test_a_receiver_with_a_certificate_of_the_plants_own(
    api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No setting of the service made it trusted, and the journal did not say what was wrong."""
    monkeypatch.delenv("SSL_CERT_FILE", raising=False)
    certificate = self_signed(tmp_path)
    with receiver(certificate) as mes:
        webhook_id = made(api, mes.url)
        first = send_test(api, webhook_id)
        wait_until(
            lambda: delivery(api, webhook_id, first)["last_failure"] is not None, 120.0, "it is refused"
        )
        assert "CERTIFICATE_VERIFY_FAILED" in delivery(api, webhook_id, first)["last_failure"]
        monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
        second = send_test(api, webhook_id)
        wait_until(lambda: delivery(api, webhook_id, second)["status"] == "delivered", 120.0, "it is known")
        assert len(mes.received) == 1


def self_signed(folder: Path) -> Path:
    """Return a file of a certificate of `localhost` and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "localhost")])
    now = datetime.now(UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.DNSName("localhost")]), critical=False)
        .sign(key, hashes.SHA256())
    )
    path = folder / "certificate.pem"
    path.write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
        + certificate.public_bytes(serialization.Encoding.PEM)
    )
    return path
