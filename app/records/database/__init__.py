"""The database: engines, transactions, what it refuses; transactions that come together share a commit."""

from app.records.database.database import Database
from app.records.database.engines import sqlite_driver, sqlite_version
from app.records.database.patience import BUSY_TIMEOUT_S
from app.records.database.refusals import is_damage, map_database_errors

__all__ = [
    "BUSY_TIMEOUT_S",
    "Database",
    "is_damage",
    "map_database_errors",
    "sqlite_driver",
    "sqlite_version",
]
