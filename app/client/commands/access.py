"""Options that the commands of a client share: the service's address, the API key, and how long to retry.

A command takes them as one of `ReadAccess`, `UploadAccess` and `AdminAccess`, by the scope that its key needs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import stamina
import typer
from rich.console import Console
from rich.markup import escape

from .. import ClientError, ServiceClient
from ..credentials import saved_key, usual_address
from ..http import ArgumentRefused, service_address
from .console import OptionRefused, error_console, fail, print_error

RETRY_FOR_S = 300.0
_FROM_FILE = "key"
_INVALID_FIELDS = "invalid_request"
_NOT_FOUND = 404
_UNAUTHORIZED, _TOO_MANY, _SERVER_ERROR = 401, 429, 500


def _read(context: typer.Context, path: Path | None) -> Path | None:
    if path is None:
        return None
    try:
        lines = path.read_text(encoding="utf-8").split()
    except (OSError, UnicodeDecodeError) as error:
        raise typer.BadParameter(f"{path} cannot be read: {error}", context) from None
    if len(lines) != 1:
        raise typer.BadParameter(f"{path} must hold one API key and nothing else", context)
    context.meta[_FROM_FILE] = lines[0]
    return path


def _choose(context: typer.Context, key: str | None) -> str | None:
    return context.meta.get(_FROM_FILE, key)


def _checked(url: str) -> str:
    """Return the service's address as requests take it; one that cannot be used ends the command."""
    try:
        return service_address(url) if url else ""
    except ArgumentRefused as refused:
        raise typer.BadParameter(f"{refused.detail} {refused.advice}") from None


def _key_option(scope: str) -> typer.models.OptionInfo:
    """Return the option `--api-key` of a command that needs a key of `scope`."""
    return typer.Option(
        "--api-key",
        envvar="GRIDPOSE_KEY",
        help=f"API key of scope {scope}. Prefer GRIDPOSE_KEY or --api-key-file: other users of this machine can read "
        "a command line.",
        callback=_choose,
    )


Url = Annotated[
    str,
    typer.Option(
        envvar="GRIDPOSE_URL",
        help="Address of the service.  [default: that of the last `gridpose login`, else http://127.0.0.1:8000]",
        show_default=False,
        callback=_checked,
    ),
]
ReadKey = Annotated[str | None, _key_option("read")]
UploadKey = Annotated[str | None, _key_option("upload")]
AdminKey = Annotated[str | None, _key_option("admin")]
KeyFile = Annotated[
    Path | None,
    typer.Option(
        "--api-key-file",
        envvar="GRIDPOSE_KEY_FILE",
        help="File that holds the API key; it takes precedence over --api-key.",
        is_eager=True,  # read before the callback of `--api-key`
        callback=_read,
        dir_okay=False,
    ),
]
"""Its key reaches a command as `key`."""
RetryFor = Annotated[
    float, typer.Option("--retry-timeout", help="Seconds to retry while the service is down.", min=0)
]


def open_client(console: Console, url: str, key: str | None, retry_for_s: float) -> ServiceClient:
    """Return a client of the service that prints one line on `console` before each retry.

    Without a `key` it has the one that `gridpose login` kept.
    Raises ClientError for an impossible address or key.
    """
    stamina.instrumentation.set_on_retry_hooks([])  # they would log each retry a second time
    return ServiceClient(
        url,
        key or saved_key(url),
        retry_for_s=retry_for_s,
        on_retry=lambda reason: console.print(f"[yellow]trying again: {escape(reason)}[/]"),
    )


def print_refusal(console: Console, error: ClientError, file: Path | None = None) -> int:
    """Print why a request was refused, its invalid fields, and what to do; return the exit code, 2 if nothing was sent.

    `file` is where the fields of the request were read from.
    """
    fields = [f"  {field}: {message}" for field, message in error.fields if message != error.summary]
    advice = error.advice
    if (
        fields and error.code == _INVALID_FIELDS
    ):  # whose advice is on the list of an answer, which is not shown
        advice = (
            f"Correct {'this field' if len(fields) == 1 else 'these fields'}{f' in {file}' if file else ''}."
        )
    code = f" ({error.code})" if error.code else ""
    print_error(console, "\n".join([f"{error.summary}{code}", *fields]), advice)
    return exit_code(error)


def exit_code(error: ClientError) -> int:
    """Return 2 where nothing was sent, else 1."""
    return 2 if isinstance(error, ArgumentRefused) else 1


def act_on_each(ids: Sequence[str], act: Callable[[str], None], shown_by: str) -> None:
    """Let `act` do something with each of several resources; end the command with 1 where one is refused.

    What the service refuses of one is printed with its id, and the others follow. A failure that all of them share, as
    of the network or the key, ends it and is raised. `shown_by` is the command that shows the ids.
    """
    console, advice = error_console(), dict[str, None]()
    failed = 0
    for place, one in enumerate(ids):
        try:
            act(one)
        except ClientError as error:
            if _is_of_all(error):
                print_error(console, f"Not done: {', '.join(ids[place:])}.")
                raise
            failed += 1
            print_error(console, f"{one}: {error}")
            is_unknown = error.status == _NOT_FOUND or error.code.endswith("_not_found")
            advice[f"Check the id; `{shown_by}` shows it." if is_unknown else error.advice or ""] = None
    for text in filter(None, advice):
        console.print(escape(text))
    if failed:
        raise typer.Exit(1)


def _is_of_all(error: ClientError) -> bool:
    status = error.status or 0
    is_service = status in (_UNAUTHORIZED, _TOO_MANY) or status >= _SERVER_ERROR
    return is_service or error.code in ("unreachable", "unexpected_answer")


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadAccess:
    """How a command that reads reaches the service."""

    url: Url = ""
    key: ReadKey = None
    key_file: KeyFile = None
    retry_for: RetryFor = RETRY_FOR_S

    def __post_init__(self) -> None:
        if not self.url:
            object.__setattr__(self, "url", usual_address(key_given=self.key is not None))

    def client(self, console: Console) -> ServiceClient:
        """Return a client of the service, as `open_client` does."""
        return open_client(console, self.url, self.key, self.retry_for)

    @contextmanager
    def connect(self, file: Path | None = None) -> Iterator[ServiceClient]:
        """Give a client; print what is refused and end the command.

        The exit code is 2 for OptionRefused and ArgumentRefused, 1 for a refusal of the service. `file` holds the
        fields that are sent.
        """
        errors = error_console()
        try:
            with self.client(errors) as client:
                yield client
        except OptionRefused as refused:
            fail(str(refused), refused.advice, code=2)
        except ClientError as error:
            raise typer.Exit(print_refusal(errors, error, file)) from None


@dataclass(frozen=True, slots=True, kw_only=True)
class UploadAccess(ReadAccess):
    """How a command that creates or corrects reaches the service."""

    key: UploadKey = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AdminAccess(ReadAccess):
    """How a command that deletes reaches the service."""

    key: AdminKey = None
