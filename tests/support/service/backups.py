"""Content to back up, and how to compare it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
import sqlalchemy as sa

from app.errors import BackupRefused
from app.records.database import Database
from app.records.tables import AccessVersion, MeasurementChange, Table

_OF_TRIGGERS = (AccessVersion.__tablename__, MeasurementChange.__tablename__)
"""What triggers write, in each database for itself."""


def image(number: int) -> bytes:
    """A small grey image, another one for each number."""
    return bytes(cv2.imencode(".png", np.full((8, 8 + number), number, np.uint8))[1])


def upload(api: Any, session_id: str, *numbers: int) -> list[str]:
    for number in numbers:
        assert api.put_image(session_id, image(number)).status_code == 202
    return [hashlib.sha256(image(number)).hexdigest() for number in numbers]


def content(database: Database) -> dict[str, list[dict[str, Any]]]:
    with database.read() as records:
        return {
            table.name: [
                dict(row._mapping) for row in records.execute(sa.select(table).order_by(*table.primary_key))
            ]
            for table in Table.metadata.sorted_tables
            if table.name not in _OF_TRIGGERS
        }


def refused(what: Callable[[], Any]) -> str:
    with pytest.raises(BackupRefused) as caught:
        what()
    assert caught.value.advice
    return caught.value.code
