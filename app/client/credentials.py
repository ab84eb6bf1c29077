"""API keys of this user: from the environment, a file, the system's credential store, or what `gridpose login` kept.

The credential store is used where the package `keyring` is installed (the extra `gridpose[keyring]`) and works; else
keys are in a file that only the user may read.
"""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
from typing import Any

import platformdirs

from .http import ClientError, service_address

DEFAULT_URL = "http://127.0.0.1:8000"
_SERVICE = "gridpose"
_ADDRESS = "address"


def credentials_file() -> Path:
    """Return where keys are kept without a credential store."""
    return platformdirs.user_config_path(_SERVICE, appauthor=False) / "credentials.json"


def find_key(url: str) -> str | None:
    """Return the key for a service, or None: GRIDPOSE_KEY, the file GRIDPOSE_KEY_FILE, or what `save_key` kept.

    Raises ClientError `key_unreadable` where a file cannot be read.
    """
    if key := os.environ.get("GRIDPOSE_KEY"):
        return key
    if path := os.environ.get("GRIDPOSE_KEY_FILE"):
        return read_key_file(Path(path))
    return saved_key(url)


def usual_address(*, key_given: bool) -> str:
    """Return the service's address where none is given: that of the last `gridpose login`, else this machine.

    A key that is given otherwise is never sent where another one was kept for: its service is this machine's.
    """
    with contextlib.suppress(ClientError):  # the key is read of the same file, and the error reported then
        address = _file_content().get(_ADDRESS)
        if isinstance(address, str) and not key_given:
            return address
    return DEFAULT_URL


def read_key_file(path: Path) -> str:
    """Return the one key that a file holds. Raises ClientError `key_unreadable`."""
    try:
        words = path.read_text(encoding="utf-8").split()
    except (OSError, UnicodeDecodeError) as error:
        raise ClientError(
            "key_unreadable", f"{path} cannot be read: {error}.", "Check --api-key-file or GRIDPOSE_KEY_FILE."
        ) from error
    if len(words) != 1:
        raise ClientError(
            "key_unreadable", f"{path} does not hold one key.", "Write the API key into it and nothing else."
        )
    return words[0]


def saved_key(url: str) -> str | None:
    """Return the key that `save_key` kept for a service, or None."""
    ring = _ring()
    if ring is not None:
        with contextlib.suppress(ring.errors.KeyringError):
            if key := ring.get_password(_SERVICE, _name(url)):
                return str(key)
    key = _file_content().get(_name(url))
    return str(key) if key is not None else None


def save_key(url: str, key: str) -> str:
    """Keep a key for a service and return where: the credential store, else a file that only the user may read.

    The service is then the one that is meant where no address is given.

    Raises ClientError `key_unreadable` where neither can be written.
    """
    ring = _ring()
    if ring is not None:
        with contextlib.suppress(ring.errors.KeyringError):
            ring.set_password(_SERVICE, _name(url), key)
            _write_file({**_file_content(), _ADDRESS: _name(url)})
            return f"the system's credential store ({ring.get_keyring().name})"
    _write_file({**_file_content(), _name(url): key, _ADDRESS: _name(url)})
    return str(credentials_file())


def forget_key(url: str) -> bool:
    """Remove the key kept for a service; return whether there was one."""
    found = False
    ring = _ring()
    if ring is not None:
        with contextlib.suppress(ring.errors.KeyringError):
            ring.delete_password(_SERVICE, _name(url))
            found = True
    content = _file_content()
    kept = content.pop(_name(url), None)
    if content.get(_ADDRESS) == _name(url):
        del content[_ADDRESS]
        kept = kept or ""
    if kept is not None:
        _write_file(content)
        found = True
    return found


def _name(url: str) -> str:
    return service_address(url)


def _ring() -> Any:
    """Return the package of the credential store, None where it is missing or has no working store."""
    try:
        import keyring
    except ImportError:
        return None
    return keyring if keyring.get_keyring().priority > 0 else None


def _file_content() -> dict[str, Any]:
    path = credentials_file()
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise ClientError(
            "key_unreadable", f"{path} cannot be read: {error}.", "Remove it, and run `gridpose login` again."
        ) from error
    return content if isinstance(content, dict) else {}


def _write_file(content: dict[str, Any]) -> None:
    path = credentials_file()
    fresh = path.with_name(f"{path.name}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        fresh.unlink(missing_ok=True)
        # Private from its first byte on; Windows keeps a user's folders private itself.
        with os.fdopen(
            os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8"
        ) as stream:
            json.dump(content, stream, indent=2)
        fresh.replace(path)
    except OSError as error:
        raise ClientError(
            "key_unreadable", f"{path} cannot be written: {error.strerror}.", "Use GRIDPOSE_KEY instead."
        ) from error
