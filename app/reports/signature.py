"""The detached signature of a report: Ed25519 over a manifest that holds the SHA-256 of each form.

The signing key is derived from the installation's pepper (HKDF-SHA256, RFC 5869), so that a backup holds it and a
restored installation signs as before. A signature says that the holder of a key made these files; whose key it is, the
reader must know: the fingerprint is compared with one that was had from the installation itself.

Reference: Josefsson and Liusvaara, "Edwards-Curve Digital Signature Algorithm (EdDSA)", RFC 8032, 2017.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

ALGORITHM = "Ed25519"
_STATED = ("report_id", "kind", "made_at", "core_version")
_INFO = b"gridpose report signing key 1"


class SignatureUnreadable(Exception):
    """What was given is no signature of a report."""


@dataclass(frozen=True, slots=True)
class CheckedFile:
    """What a signature says of a file: its form, None where the report has no such form, and the signing key."""

    form: str | None
    is_signature_valid: bool
    fingerprint: str
    manifest: Mapping[str, Any]

    @property
    def is_valid(self) -> bool:
        """Whether the file is one that was signed, unchanged."""
        return self.is_signature_valid and self.form is not None


def signing_key(pepper: bytes) -> Ed25519PrivateKey:
    """Return the installation's signing key."""
    seed = HKDF(algorithm=SHA256(), length=32, salt=None, info=_INFO).derive(pepper)
    return Ed25519PrivateKey.from_private_bytes(seed)


def fingerprint_of(key: Ed25519PrivateKey | Ed25519PublicKey) -> str:
    """Return the SHA-256 of a public key's 32 bytes, by which people compare keys: 64 hex digits."""
    public = key.public_key() if isinstance(key, Ed25519PrivateKey) else key
    return hashlib.sha256(public.public_bytes_raw()).hexdigest()


def sign_report(key: Ed25519PrivateKey, manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return the signature of a manifest, as `report.sig` holds it."""
    return {
        "manifest": dict(manifest),
        "algorithm": ALGORITHM,
        "public_key": base64.b64encode(key.public_key().public_bytes_raw()).decode(),
        "signature": base64.b64encode(key.sign(_signed_bytes(manifest))).decode(),
    }


def check_file(content: bytes, signature: bytes) -> CheckedFile:
    """Compare a file with a detached signature. Raises SignatureUnreadable."""
    try:
        document = json.loads(signature)
        manifest, forms = document["manifest"], document["manifest"]["forms"]
        public, raw = _key_and_signature(document)
        stated = [manifest[name] for name in _STATED]
        if not all(isinstance(text, str) and text.isprintable() for text in stated):
            raise SignatureUnreadable(
                "its manifest does not say which report it is of"
            )  # nor reaches a terminal
        if document["algorithm"] != ALGORITHM or not isinstance(forms, dict):
            raise SignatureUnreadable(f"it is not an {ALGORITHM} signature of a report")
    except (ValueError, KeyError, TypeError, binascii.Error, RecursionError) as error:
        raise SignatureUnreadable("it does not hold manifest, public_key and signature") from error
    valid = _is_signed(public, raw, manifest)
    sha256 = hashlib.sha256(content).hexdigest()
    form = next((name for name, one in forms.items() if one == sha256), None)
    return CheckedFile(form, valid, fingerprint_of(public), manifest)


def check_manifest(manifest: Mapping[str, Any], signature: bytes) -> str | None:
    """Return the fingerprint of the key that signed a manifest; None where it signed another.

    Raises SignatureUnreadable.
    """
    try:
        document = json.loads(signature)
        public, raw = _key_and_signature(document)
    except (ValueError, KeyError, TypeError, binascii.Error, RecursionError) as error:
        raise SignatureUnreadable("it does not hold public_key and signature") from error
    return fingerprint_of(public) if _is_signed(public, raw, manifest) else None


def _key_and_signature(document: Mapping[str, Any]) -> tuple[Ed25519PublicKey, bytes]:
    public = Ed25519PublicKey.from_public_bytes(base64.b64decode(document["public_key"], validate=True))
    return public, base64.b64decode(document["signature"], validate=True)


def _is_signed(public: Ed25519PublicKey, signature: bytes, manifest: Mapping[str, Any]) -> bool:
    try:
        public.verify(signature, _signed_bytes(manifest))
    except InvalidSignature:
        return False
    return True


def _signed_bytes(manifest: Mapping[str, Any]) -> bytes:
    """Return the manifest's canonical text: keys sorted, no spaces, ASCII; it holds text and whole numbers alone."""
    return json.dumps(manifest, sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode()
