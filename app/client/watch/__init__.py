"""Watch a folder for months and send each image once.

`files` lists the folder and reads files, sidecars and tables, `delivery` makes one complete file an upload, `journal`
keeps what became of each file, `gate` holds requests back while the service is away, `results` follows what was sent,
`report` says what happens, and `watcher` does it in order.
"""

from .journal import Journal, JournalInUse, JournalUnusable
from .report import Report
from .session import CannotBegin
from .settings import WatchSettings
from .watcher import Watcher, WatchSummary

__all__ = [
    "CannotBegin",
    "Journal",
    "JournalInUse",
    "JournalUnusable",
    "Report",
    "WatchSettings",
    "WatchSummary",
    "Watcher",
]
