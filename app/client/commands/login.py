"""`gridpose login` and `logout`: the API key of a service, kept for this user."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from .. import ClientError, ServiceClient
from ..credentials import forget_key, read_key_file, save_key, usual_address
from .access import Url, exit_code
from .console import fail

_NOT_ALLOWED = 403


def login(
    url: Url = "",
    key_file: Annotated[
        str | None,
        typer.Option(
            "--api-key-file", help="File that holds the key, or - for standard input.  [default: ask]"
        ),
    ] = None,
) -> int:
    """Keep an API key for a service, so that commands and programs of this user need no other.

    From then on this service is meant where no --url is given. The key is tried first. It is kept in the system's
    credential store where the extra gridpose[keyring] is installed, else in a file that only this user may read.
    """
    url = url or usual_address(key_given=False)
    try:
        key = _key(url, key_file)
        with ServiceClient(url, key, retry_for_s=10.0) as client:
            scope = _scope(client)
        place = save_key(url, key)
    except ClientError as error:
        fail(str(error), error.advice, code=exit_code(error))
    print(f"the key for {url} is kept in {place}; {scope}")
    return 0


def logout(url: Url = "") -> int:
    """Forget the API key that was kept for a service."""
    url = url or usual_address(key_given=False)
    try:
        found = forget_key(url)
    except ClientError as error:
        fail(str(error), error.advice)
    print(f"the key for {url} is forgotten" if found else f"no key was kept for {url}")
    return 0


def _key(url: str, key_file: str | None) -> str:
    if key_file == "-":
        return sys.stdin.readline().strip()
    if key_file is not None:
        return read_key_file(Path(key_file).expanduser())
    if not sys.stdin.isatty():
        raise ClientError(
            "invalid_key",
            "There is no terminal to ask for the key on.",
            "Give --api-key-file FILE, or - for stdin.",
        )
    key: str = typer.prompt(f"API key for {url}", hide_input=True)
    return key.strip()


def _scope(client: ServiceClient) -> str:
    """Return what the key may do. Raises ClientError where the service refuses it."""
    try:
        client.get("/v1/sessions")
    except ClientError as error:
        if error.status == _NOT_ALLOWED:
            return "it may send images, and not read results (scope ingest): give sessions by their ids"
        raise
    return "it may read sessions and results"
