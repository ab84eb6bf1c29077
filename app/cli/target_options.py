"""Which target the `gridpose target` commands are about: described by options, or stored in a service."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields

from app.agent import ClientError, Json, ServiceClient
from core import TargetSpec
from core.errors import InvalidArgument
from core.targets.target_fields import check_fields

_ID = re.compile(r"[0-9A-Za-z_-]+")


@dataclass(frozen=True, slots=True, kw_only=True)
class Service:
    """Where a service is, and how to speak with it."""

    url: str
    key: str | None
    retry_for_s: float

    def client(self) -> ServiceClient:
        return ServiceClient(self.url, self.key, retry_for_s=self.retry_for_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetOptions:
    """The options that describe a target, or name one of a service's; None where not given."""

    target_id: str | None
    kind: str | None
    columns: int | None
    rows: int | None
    pitch_mm: float | None
    marker_mm: float | None
    dictionary: str | None
    legacy_layout: bool
    service: Service

    @property
    def description(self) -> list[str]:
        """The names of the options given that describe a target."""
        values = {
            "--kind": self.kind,
            "--columns": self.columns,
            "--rows": self.rows,
            "--pitch-mm": self.pitch_mm,
            "--marker-mm": self.marker_mm,
            "--dictionary": self.dictionary,
            "--legacy-layout": self.legacy_layout or None,
        }
        return [name for name, value in values.items() if value is not None]


def target_options(
    *,
    target_id: str | None,
    kind: str | None,
    columns: int | None,
    rows: int | None,
    pitch_mm: float | None,
    marker_mm: float | None,
    dictionary: str | None,
    legacy_layout: bool,
    url: str,
    key: str | None,
    retry_for: float,
) -> TargetOptions:
    """Return the options that the commands have in common, as they are given on the command line."""
    return TargetOptions(
        target_id=target_id,
        kind=None if kind is None else str(kind),
        columns=columns,
        rows=rows,
        pitch_mm=pitch_mm,
        marker_mm=marker_mm,
        dictionary=dictionary,
        legacy_layout=legacy_layout,
        service=Service(url=url, key=key, retry_for_s=retry_for),
    )


@dataclass(frozen=True, slots=True)
class Named:
    """A target, and its name in a service."""

    target: TargetSpec
    name: str | None


def chosen_target(options: TargetOptions) -> Named:
    """Return the target described or named.

    Raises InvalidArgument for options that describe none or two, InvalidTarget for impossible ones, ClientError where
    the service does not give it.
    """
    described = options.description
    if options.target_id is not None:
        if described:
            raise InvalidArgument(
                f"--target-id already says what {', '.join(described)} would.", "Give the one or the others."
            )
        if _ID.fullmatch(options.target_id) is None:
            raise InvalidArgument(
                f"--target-id {options.target_id!r} is no id.",
                "Ids begin with tgt_; GET /v1/targets lists them.",
            )
        with options.service.client() as client:
            return stored_target(client.get(f"/v1/targets/{options.target_id}"))
    missing = [name for name in ("--kind", "--columns", "--rows", "--pitch-mm") if name not in described]
    if missing:
        raise InvalidArgument(
            f"What is printed is not told: {', '.join(missing)} missing.",
            "Describe the target, e.g. --kind chessboard --columns 9 --rows 6 --pitch-mm 25, or give the "
            "--target-id of a service's.",
        )
    target = TargetSpec(
        str(options.kind),
        options.columns or 0,
        options.rows or 0,
        options.pitch_mm or 0.0,
        options.marker_mm,
        options.dictionary,
        options.legacy_layout,
    )
    check_fields(target)
    return Named(target, None)


def stored_target(answer: Json) -> Named:
    """Return a target as a service described it."""
    known = {field.name for field in fields(TargetSpec)}
    unknown = set(answer) - known - {"id", "name", "created_at"}
    if unknown:
        raise ClientError(
            "unknown_fields",
            f"The service describes its target by what this program does not know: {', '.join(sorted(unknown))}.",
            "Update gridpose on this machine.",
        )
    return Named(TargetSpec(**{name: answer[name] for name in known & set(answer)}), answer["name"])
