"""Everything that can be configured, read from the environment (`GRIDPOSE_*`)."""

from __future__ import annotations

import difflib
import ipaddress
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, Self

import platformdirs
from pydantic import Field, SecretStr, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

MIB = 1024 * 1024
_PREFIX = "GRIDPOSE_"
_OF_TESTS = "GRIDPOSE_TEST_"
_OF_OTHERS = frozenset(
    {"GRIDPOSE_URL", "GRIDPOSE_KEY", "GRIDPOSE_KEY_FILE", "GRIDPOSE_MEMORY", "GRIDPOSE_PUBLISH"}
)
"""Variables of commands that call a service, and of `docker/compose.yaml`."""
Network = ipaddress.IPv4Network | ipaddress.IPv6Network


class Settings(BaseSettings):
    """One running service's configuration."""

    model_config = SettingsConfigDict(env_prefix=_PREFIX, frozen=True, env_ignore_empty=True)

    data_dir: Annotated[
        Path, Field(description="Folder of the database, the originals and the key pepper.")
    ] = Field(default_factory=lambda: platformdirs.user_data_path("gridpose"))
    host: Annotated[str, Field(description="Address to listen on.")] = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535, description="Port to listen on; 0 takes a free one.")] = 8000
    workers: Annotated[
        int | None,
        Field(ge=0, le=256, description="Processes that compute; 0: none in this process; default: cores."),
    ] = None
    auth: Annotated[
        Literal["on", "off"],
        Field(description="`off` lets everyone do everything; only with a loopback address."),
    ] = "on"
    trusted_proxies: Annotated[
        str | None,
        Field(
            description="Addresses or networks of reverse proxies, by commas, whose `X-Forwarded-For` is believed."
        ),
    ] = None
    database_url: Annotated[
        str | None,
        Field(description="`postgresql+psycopg://user@host/name`; default: SQLite in the data folder."),
    ] = None
    blob_url: Annotated[
        str | None,
        Field(
            description="`s3://bucket/prefix` for the images, with the usual `AWS_*` variables; "
            "default: files in the data folder.",
        ),
    ] = None
    key_pepper: Annotated[
        SecretStr | None,
        Field(description="Secret the API keys are hashed with; default: made once in the data folder."),
    ] = None
    job_timeout_s: Annotated[
        float, Field(gt=0, le=86400, description="Longest computation of one image, seconds.")
    ] = 60.0
    analysis_timeout_s: Annotated[
        float, Field(gt=0, le=86400, description="Longest computation of one analysis, seconds.")
    ] = 180.0
    analysis_memory_bytes: Annotated[
        int, Field(ge=512 * MIB, description="Largest memory of one analysis, bytes; watched on Linux.")
    ] = 2048 * MIB
    max_upload_bytes: Annotated[int, Field(ge=1, description="Largest image file taken, bytes.")] = 128 * MIB
    max_image_pixels: Annotated[int, Field(ge=1, description="Largest image taken, width times height.")] = (
        100_000_000
    )
    disk_floor_bytes: Annotated[
        int, Field(ge=0, description="Free disk space below which uploads are refused, bytes.")
    ] = 256 * MIB
    retention_days: Annotated[
        int | None,
        Field(
            ge=1,
            le=36500,
            description="Days after its last upload that a session is removed with its originals; default: never.",
        ),
    ] = None
    alert_file: Annotated[
        Path | None,
        Field(description="File that gets a line of JSON for each notice; default: none."),
    ] = None
    log_level: Annotated[
        Literal["debug", "info", "warning", "error"], Field(description="Least severe message logged.")
    ] = "info"

    @field_validator("database_url")
    @classmethod
    def _require_database(cls, value: str | None) -> str | None:
        if value is not None and not re.match(r"postgresql\+psycopg://[^/]*/[^/]+|sqlite:////?[^/]", value):
            raise ValueError("write postgresql+psycopg://user@host/name")
        return value

    @field_validator("blob_url")
    @classmethod
    def _require_bucket(cls, value: str | None) -> str | None:
        if value is not None and not re.fullmatch(
            r"s3://[a-z0-9][a-z0-9.-]{1,61}[a-z0-9](/[A-Za-z0-9._/-]*)?", value
        ):
            raise ValueError("write s3://bucket/prefix, the prefix of letters, digits, '.', '_', '-' and '/'")
        return value

    @field_validator("trusted_proxies")
    @classmethod
    def _require_networks(cls, value: str | None) -> str | None:
        _networks(value or "")
        return value

    @model_validator(mode="after")
    def _refuse_open_service(self) -> Self:
        if self.auth == "off" and not is_loopback(self.host):
            raise ValueError(
                f"GRIDPOSE_AUTH=off is only allowed on a loopback address such as 127.0.0.1, not on {self.host!r}"
            )
        return self

    @property
    def worker_count(self) -> int:
        """Processes to compute with: as set, or one per core this process may use."""
        if self.workers is not None:
            return self.workers
        if hasattr(os, "sched_getaffinity"):
            return len(os.sched_getaffinity(0))
        return os.cpu_count() or 1

    @property
    def trusted_networks(self) -> tuple[Network, ...]:
        """The networks of `trusted_proxies`."""
        return _networks(self.trusted_proxies or "")

    @property
    def is_shared(self) -> bool:
        """Whether several machines may serve and compute: database and images lie on none of them."""
        return self.blob_url is not None and self.database_url is not None

    @property
    def effective_database_url(self) -> str:
        """The database's address, SQLite in the data folder unless one was given."""
        return self.database_url or f"sqlite:///{self.data_dir / 'gridpose.sqlite3'}"


def unknown_settings(environment: Mapping[str, str]) -> list[tuple[str, str | None]]:
    """Return every `GRIDPOSE_*` variable that nothing reads, with the name of a setting that is like it, if one is."""
    known = [f"{_PREFIX}{name}".upper() for name in Settings.model_fields]
    found = []
    for name in sorted(environment):
        upper = name.upper()  # as settings are read
        if (
            upper in known
            or upper in _OF_OTHERS
            or not upper.startswith(_PREFIX)
            or upper.startswith(_OF_TESTS)
        ):
            continue
        nearest = difflib.get_close_matches(upper, known, n=1, cutoff=0.7)
        found.append((name, nearest[0] if nearest else None))
    return found


def _networks(text: str) -> tuple[Network, ...]:
    return tuple(ipaddress.ip_network(part.strip()) for part in text.split(",") if part.strip())


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach `host`."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
