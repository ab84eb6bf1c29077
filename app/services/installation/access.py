"""Keys and sessions' targets, which every request asks for, in memory as long as the database's version stays.

A key that is revoked, whoever revokes it, counts no more from the next request on: each request reads the version
(microseconds on SQLite). Where it cannot be read at once (`Database.access_version`), nothing is kept.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from app.records.database import Database
from app.records.tables import ApiKey

MAX_KEPT = 10_000
"""Entries of each kind; beyond it they are collected anew."""


@dataclass(frozen=True, slots=True)
class AccessFacts:
    """What was read under one version. What is read later may be newer: then the version has moved on, too."""

    version: int
    keys: dict[str, ApiKey] = field(default_factory=dict)
    """By their ids; an id of no key is not kept."""
    targets: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Ids of each session's targets, in its order, by the session's id."""

    @property
    def crowded(self) -> bool:
        """Whether no more should be added."""
        return max(len(self.keys), len(self.targets)) >= MAX_KEPT


class AccessCache:
    """The facts under the present version; safe to use from several threads."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._facts = AccessFacts(-1)

    def current(self) -> AccessFacts | None:
        """Return the facts that hold now, to be read and added to; None where they cannot be known at once.

        Ask before what is added is read from the database.
        """
        version = self._database.access_version()
        if version is None:
            return None
        facts = self._facts
        if facts.version != version or facts.crowded:
            facts = self._facts = AccessFacts(version)
        return facts
