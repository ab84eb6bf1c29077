"""The client of S3: which bucket, how long to wait and how often to try again, and what its errors mean.

Credentials, region and endpoint come from the usual `AWS_*` variables. Every process has one client for each address.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from functools import cache
from typing import TYPE_CHECKING

from app.errors import ServiceError, StorageFull, Unavailable
from app.logs import Logger

if TYPE_CHECKING:
    from obstore.store import S3Store

SCHEME = "s3://"
ANSWER_S = 20
"""How long one request may take. An upload answers 503 after RETRIED_S and one such request at most."""
CONNECT_S = 5
RETRIED_S = 15

log = Logger(__name__)


def is_object_address(address: str) -> bool:
    """Return whether an address is one of S3, and not a path."""
    return address.startswith(SCHEME)


@cache
def store_of(url: str) -> S3Store:
    """Return this process's client of a bucket and prefix, `s3://bucket/prefix`."""
    # obstore is an extra: it is imported where S3 is used, and only there.
    from obstore.store import S3Store

    endpoint = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or ""
    store = S3Store.from_url(
        url,
        virtual_hosted_style_request=os.environ.get("AWS_VIRTUAL_HOSTED_STYLE_REQUEST", "") == "true",
        client_options={
            "allow_http": endpoint.startswith("http://"),
            "timeout": timedelta(seconds=ANSWER_S),
            "connect_timeout": timedelta(seconds=CONNECT_S),
        },
        retry_config={
            "max_retries": 8,
            "retry_timeout": timedelta(seconds=RETRIED_S),
            "backoff": {
                "init_backoff": timedelta(milliseconds=100),
                "max_backoff": timedelta(seconds=3),
                "base": 2,
            },
        },
    )
    return store


def split_address(address: str) -> tuple[str, str]:
    """Return the bucket's address and the key of an object's address."""
    bucket, _, key = address.removeprefix(SCHEME).partition("/")
    return SCHEME + bucket, key


@contextmanager
def map_object_errors(what: str) -> Iterator[None]:
    """Turn what S3 refuses into the service's own errors; what is not there stays FileNotFoundError."""
    from obstore.exceptions import (
        AlreadyExistsError,
        BaseError,
        NotFoundError,
        PermissionDeniedError,
        UnauthenticatedError,
    )

    try:
        yield
    except (AlreadyExistsError, NotFoundError, FileNotFoundError):
        raise
    except (PermissionDeniedError, UnauthenticatedError) as error:
        log.error("objects_refused", what=what, error=_first_line(error))
        raise Unavailable(
            "The object store refuses the service.",
            "Check the AWS_* credentials and the bucket's policy: `gridpose doctor` on the server.",
            code="storage_refused",
        ) from error
    except (BaseError, OSError) as error:
        log.error("objects_not_reached", what=what, error=_first_line(error))
        if "507" in str(error) or "InsufficientStorage" in str(error) or "QuotaExceeded" in str(error):
            raise StorageFull("The object store has no room for this.") from error
        raise Unavailable(
            "The object store cannot be reached or is busy.", "Try again shortly.", code="storage_unavailable"
        ) from error


def read_object(address: str) -> bytes:
    """Return the bytes of an object; raises FileNotFoundError, Unavailable."""
    import obstore

    bucket, key = split_address(address)
    with map_object_errors("read"):
        return bytes(obstore.get(store_of(bucket), key).bytes())


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0][:300] if str(error).strip() else type(error).__name__


def delete_object(store: S3Store, key: str) -> bool:
    """Remove an object, if there is one; return False, and log why, where S3 refuses."""
    import obstore

    try:
        with map_object_errors("delete"):
            obstore.delete(store, key)
    except FileNotFoundError:
        return True
    except ServiceError as error:
        log.warning("object_not_removed", key=key, reason=error.code)
        return False
    return True
