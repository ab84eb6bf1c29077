"""A session's archive: one file from which another installation has the session again, years later.

README.txt            what the file is, for people
manifest.json         whose it is, its schema, and every file with size and SHA-256
manifest.sig          the installation's signature of the manifest, as reports have it
rows/TABLE.jsonl      the rows: robot, targets, session, poses, measurements, results, reports
originals/SHA256.EXT  every original, byte for byte
reports/ID/           every form of every report, with its signature

The file is a gzip-compressed tar of plain files in this order, which any system unpacks; `restore_session` reads it in
one pass and takes nothing but what the manifest names next.
"""

from app.services.archive.making import archive_session
from app.services.archive.manifest import ArchiveManifest
from app.services.archive.restoring import restore_session

__all__ = ["ArchiveManifest", "archive_session", "restore_session"]
