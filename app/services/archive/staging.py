"""The rows of an archive in a database of their own: at the archive's schema, then at this version's, then examined."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from app.errors import ArchiveRefused
from app.records import migrations
from app.records.codec import are_markers, are_points, content_hash
from app.records.database import Database
from app.records.readable import unreadable_values
from app.records.rows import tables_in
from app.records.tables import (
    MeasuredPose,
    Measurement,
    Pose,
    Qualification,
    Report,
    ReportForm,
    Result,
    Session,
    SessionTarget,
    Table,
)
from app.reports.signature import SignatureUnreadable, check_file
from app.services.archive.container import damaged
from app.services.archive.manifest import ArchivedFile, ArchiveManifest
from app.services.archive.rows import MAX_LINE_BYTES, OF_SESSION, decode_row
from app.services.reports import inflated, signature_file

Json = dict[str, Any]
_AT_ONCE = 200
_NAME_SESSION = (Session, SessionTarget, Pose, Measurement, MeasuredPose, Report, Qualification)
_FORMS = ReportForm.__tablename__
_REFUSED_BY_DATABASE = (sa.exc.SQLAlchemyError, OverflowError, ValueError, TypeError)
"""What inserting values raises that a table does not take."""


class StagedRows:
    """A database in `folder` that takes the rows of one archive, member by member, and then examines them."""

    def __init__(self, folder: Path, manifest: ArchiveManifest) -> None:
        self._folder = folder
        self._manifest = manifest
        self._forms: dict[tuple[str, str], Json] = {}
        self.database = Database(sa.URL.create("sqlite", database=str(folder / "rows.sqlite3")))
        try:
            migrations.require_known(manifest.revision)
            self._is_current = manifest.revision == migrations.head_revision()
            if self._is_current:  # the same tables as the migrations make, at once
                Table.metadata.create_all(self.database.engine)
            else:
                migrations.upgrade(self.database, folder, revision=manifest.revision, copy_first=False)
        except migrations.SchemaTooNew as error:
            self.close()
            raise ArchiveRefused(
                "archive_too_new",
                f"The archive has schema {manifest.revision}, which this version does not know.",
                "Install the version that made it, or a later one.",
            ) from error
        with self.database.engine.connect() as connection:
            self._tables = tables_in(connection)

    def lines(self, table: str) -> RowLines:
        """Return what takes the bytes of a table's rows. Raises ArchiveRefused where no such rows are archived."""
        if table not in self._tables or table not in {one.__tablename__ for one in OF_SESSION}:
            raise damaged(f"rows of {table} belong in no archive")
        return RowLines(self, self._tables[table], self._manifest.rows[table])

    def insert(self, table: sa.TableClause, rows: list[Json]) -> None:
        """Store rows; those of forms wait for their bytes, since they never change. Raises ArchiveRefused."""
        if table.name == _FORMS:
            self._forms.update({(row["report_id"], row["form"]): row for row in rows})
            return
        try:
            with self.database.engine.begin() as connection:
                connection.execute(sa.insert(table), rows)
        except _REFUSED_BY_DATABASE as error:
            raise damaged(f"its rows of {table.name} do not fit its schema") from error

    def take_form(self, file: ArchivedFile, content: bytes) -> None:
        """Store the bytes of a report's form, or compare its signature with that of its row. Raises ArchiveRefused."""
        assert file.form is not None, "the manifest names rows, originals and forms"
        if file.form[1] == "sig":
            with self.database.read() as records:
                signature = records.scalar(sa.select(Report.signature).where(Report.id == file.form[0]))
            if signature is None or signature_file(signature) != content:
                raise damaged(f"{file.name} is not the signature of its report")
            return
        row = self._forms.pop(file.form, None)
        if row is None or row["sha256"] != file.sha256:
            raise damaged(f"no report has the form {file.name}")
        row["content"] = zlib.compress(content, 6)
        try:
            with self.database.engine.begin() as connection:
                connection.execute(sa.insert(self._tables[_FORMS]), [row])
        except _REFUSED_BY_DATABASE as error:
            raise damaged(f"{file.name} does not fit its schema") from error

    def complete(self) -> None:
        """Bring all rows to this version's schema and examine them. Raises ArchiveRefused."""
        if self._forms:
            raise damaged(f"the form {' of '.join(reversed(next(iter(self._forms))))} is missing")
        if not self._is_current:
            migrations.upgrade(self.database, self._folder, copy_first=False)
        with self.database.snapshot() as connection:
            for table in OF_SESSION:
                for row in connection.execute(sa.select(table.__table__)):
                    values = dict(row._mapping)
                    if names := unreadable_values(table, values):
                        raise damaged(f"a row of {table.__tablename__} has no readable {', '.join(names)}")
                    self._examine(table, values)
            self._examine_reports(connection)

    def close(self) -> None:
        """Close the database."""
        self.database.dispose()

    def _examine(self, table: type[Table], row: Json) -> None:
        """Raise ArchiveRefused for a row of another session, or one whose hashes are not those of what it holds."""
        own, missing = self._manifest.session_id, set(self._manifest.missing)
        name = "id" if table is Session else "session_id"
        if table in _NAME_SESSION and row[name] != own:
            raise damaged(f"a row of {table.__tablename__} belongs to another session")
        if table is Measurement:
            held = {file.sha256: file.bytes for file in self._manifest.originals}
            if row["status"] not in ("succeeded", "failed"):
                raise damaged(f"measurement {row['id']} is not finished")
            if row["sha256"] not in missing and held.get(row["sha256"]) != row["bytes"]:
                raise damaged(f"the original of measurement {row['id']} is not in it")
        if table is Result:
            points, markers = row["points"], row["markers"]
            whole = (points is None or are_points(points)) and (markers is None or are_markers(markers))
            if not whole or content_hash(points, markers) != row["content_sha256"]:
                raise damaged(f"the grid points of measurement {row['measurement_id']} have another hash")

    def _examine_reports(self, connection: sa.Connection) -> None:
        """Raise ArchiveRefused unless every report is made, signed, and has the very forms that were signed."""
        hashes: dict[str, dict[str, str]] = {}
        for row in connection.execute(sa.select(ReportForm.__table__)):
            content = inflated(row)
            if content is None or len(content) != row.bytes:
                raise damaged(f"the form {row.form} of report {row.report_id} has another hash")
            hashes.setdefault(row.report_id, {})[row.form] = hashlib.sha256(content).hexdigest()
        for row in connection.execute(sa.select(Report.id, Report.status, Report.signature)):
            if row.status != "succeeded" or row.signature is None:
                raise damaged(f"report {row.id} is not made")
            try:
                checked = check_file(b"", signature_file(row.signature))
            except SignatureUnreadable as error:
                raise damaged(f"the signature of report {row.id} cannot be read: {error}") from error
            manifest = checked.manifest
            if not checked.is_signature_valid or manifest["report_id"] != row.id:
                raise damaged(f"the signature of report {row.id} does not hold")
            if manifest["forms"] != hashes.get(row.id):
                raise damaged(f"report {row.id} has other forms than were signed")


class RowLines:
    """Takes the bytes of one table's rows, a JSON object in each line, and stores them some at a time."""

    def __init__(self, rows: StagedRows, table: sa.TableClause, expected: int) -> None:
        self._rows = rows
        self._table = table
        self._expected = expected
        self._rest = b""

    def take(self, piece: bytes) -> None:
        """Take the next bytes. Raises ArchiveRefused for rows that the table does not take."""
        *lines, self._rest = (self._rest + piece).split(b"\n")
        if len(self._rest) > MAX_LINE_BYTES:
            raise damaged(f"a row of {self._table.name} is longer than any")
        for some in _in_parts(lines):
            self._expected -= len(some)
            self._rows.insert(self._table, [decode_row(self._table, line) for line in some])

    def end(self) -> None:
        """Raise ArchiveRefused unless the last row was whole, and as many came as the manifest states."""
        if self._rest or self._expected:
            raise damaged(f"it has not as many rows of {self._table.name} as its manifest says")


def _in_parts(lines: list[bytes]) -> Iterator[list[bytes]]:
    for start in range(0, len(lines), _AT_ONCE):
        yield lines[start : start + _AT_ONCE]
