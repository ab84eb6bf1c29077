"""Backups: one moment of an installation as a folder of plain files, and an installation again from it.

backup-of.json        which installation this folder is for; there from the first moment
manifest.json         what a complete backup consists of, with hashes; replaced last, at once
database-*.sqlite3    all rows, whichever database they came from, of the schema named in the manifest
originals/ab/abcd...  every original the rows name, by its SHA-256
key-pepper-*          what the keys are hashed with: a backup is as confidential as the data folder
"""

from app.services.backup.damage import damage_advice
from app.services.backup.latest import LatestBackup, read_latest_backup
from app.services.backup.making import make_backup
from app.services.backup.manifest import MANIFEST, read_manifest
from app.services.backup.moving import move_installation
from app.services.backup.restoring import restore_backup

__all__ = [
    "MANIFEST",
    "LatestBackup",
    "damage_advice",
    "make_backup",
    "move_installation",
    "read_latest_backup",
    "read_manifest",
    "restore_backup",
]
