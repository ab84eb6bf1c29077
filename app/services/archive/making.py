"""A session's archive made while the service runs: the rows of one moment, then the originals they name."""

from __future__ import annotations

import glob
import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import IO, Any, BinaryIO

import sqlalchemy as sa

from app.blobs.durable import sync_folder
from app.build import core_version
from app.errors import ArchiveRefused, NotFound, OriginalMissing
from app.records.file_lock import AlreadyLocked, FileLock
from app.records.ids import is_id
from app.records.migrations import head_revision
from app.records.tables import Installation, Measurement, Report, ReportForm, Session, Table
from app.reports.signature import fingerprint_of, sign_report, signing_key
from app.services.archive import manifest as archive_manifest
from app.services.archive.container import PIECE, ArchiveWriter
from app.services.archive.manifest import ArchivedFile, ArchiveManifest
from app.services.archive.rows import OF_SESSION, archived_rows, encode_row
from app.services.installation.context import ServiceContext
from app.services.installation.outputs import output_failures
from app.services.reports import read_form, read_signature

_NAMED = 5
"""Ids that a message lists."""
_EXTENSIONS = {"jpeg": "jpg", "tiff": "tiff", "png": "png", "bmp": "bmp"}


@dataclass(frozen=True, slots=True)
class Archived:
    """An archive just made: its manifest, its own size and the fingerprint of the key that signed it."""

    manifest: ArchiveManifest
    bytes: int
    fingerprint: str


def archive_session(
    installation: ServiceContext, session: str, path: Path, *, replace: bool = False
) -> Archived:
    """Write a session, given by id or name, with everything in it to a new file, whole or not at all.

    `replace` permits a file that is there. Raises NotFound, RowUnreadable, and ArchiveRefused where several sessions
    have the name, the session is not finished, or the file is there or cannot be written.
    """
    with output_failures(installation.settings.data_dir, partial(_unwritable, path)):
        return _archived(installation, _session_id(installation, session), path, replace=replace)


def _session_id(installation: ServiceContext, session: str) -> str:
    """Return the id of the session with this id or name, as the commands on the service take either."""
    with installation.database.read() as records:
        if is_id(session) and records.get(Session, session) is not None:
            return session
        named = records.scalars(
            sa.select(Session.id).where(Session.name == session).order_by(Session.id).limit(_NAMED + 1)
        ).all()
    if not named:
        raise NotFound.of("session")
    if len(named) > 1:
        raise ArchiveRefused(
            "session_ambiguous",
            f"Several sessions have the name {session!r}: {', '.join(named[:_NAMED])}"
            f"{' and more' if len(named) > _NAMED else ''}.",
            "Give the id; `gridpose sessions list` shows them.",
        )
    return named[0]


def _unwritable(path: Path, _named: Path | None, reason: str) -> ArchiveRefused:
    return ArchiveRefused(
        "archive_unwritable",
        f"The archive {path} cannot be written: {reason}.",
        f"Check that {path.absolute().parent} is there, that this user may write to it, and that its disk is mounted, "
        "writable and has room; or name a file on another disk.",
    )


def _archived(installation: ServiceContext, session_id: str, path: Path, *, replace: bool) -> Archived:
    if path.exists() and not replace:
        raise ArchiveRefused(
            "archive_exists", f"{path} is there already.", "Name another file, or replace it with --replace."
        )
    _remove_left(path)
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with (
            unfinished.open("xb") as file,
            _in_use(unfinished),
            _Archive(installation, session_id, path.parent) as archive,
        ):
            archived = archive.write(file)
            file.flush()
            os.fsync(file.fileno())
        size = unfinished.stat().st_size
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
    sync_folder(path.parent)
    return Archived(archived, size, archive.fingerprint)


def _remove_left(path: Path) -> None:
    """Remove what an earlier archive to the same file left that was killed."""
    for left in path.parent.glob(f".{glob.escape(path.name)}.*.partial"):
        # Another process may be writing it; Windows removes no file that is open.
        with suppress(AlreadyLocked, OSError):
            lock = FileLock(left)
            lock.acquire()
            lock.release()
            left.unlink()


@contextmanager
def _in_use(unfinished: Path) -> Iterator[None]:
    """Let others see that the file is being written."""
    lock = FileLock(unfinished)
    if os.name == "posix":  # elsewhere the lock would keep this process from writing as well
        with suppress(AlreadyLocked):  # a network disk may have no locks
            lock.acquire()
    try:
        yield
    finally:
        lock.release()


class _Archive:
    """A session read from its installation; temporary files hold rows until the manifest is known.

    They lie in the archive's folder, whose disk is the only one that this writes to.
    """

    def __init__(self, installation: ServiceContext, session_id: str, folder: Path) -> None:
        self._installation = installation
        self._folder = folder
        self._session_id = session_id
        self._held = ExitStack()
        self._files: list[tuple[ArchivedFile, Callable[[], Iterator[bytes]]]] = []
        self._rows: dict[str, int] = {}
        self._missing: list[str] = []
        self.fingerprint = ""

    def __enter__(self) -> _Archive:
        return self

    def __exit__(self, *_error: object) -> None:
        self._held.close()

    def write(self, file: BinaryIO) -> ArchiveManifest:
        with self._installation.database.snapshot() as connection:
            session = self._require_finished(connection)
            for table in OF_SESSION:
                self._read_rows(connection, table)
            self._find_originals(connection)
            self._find_reports(connection)
            installation_id = connection.scalar(sa.select(Installation.id))
        made_at = datetime.now(UTC)
        manifest = ArchiveManifest(
            format=archive_manifest.FORMAT,
            format_version=archive_manifest.FORMAT_VERSION,
            session_id=self._session_id,
            session_name="".join(letter if letter.isprintable() else " " for letter in session.name),
            made_at=made_at.isoformat(timespec="seconds"),
            core_version=core_version(),
            revision=head_revision(),
            installation_id=str(installation_id),
            rows=self._rows,
            missing=self._missing,
            files=[one for one, _ in self._files],
        )
        self._write_members(ArchiveWriter(file, int(made_at.timestamp())), manifest)
        return manifest

    def _write_members(self, writer: ArchiveWriter, manifest: ArchiveManifest) -> None:
        key = signing_key(self._installation.pepper)
        signed = sign_report(key, manifest.document())
        del signed["manifest"]  # it is the file alongside
        writer.add_bytes(archive_manifest.README_NAME, archive_manifest.read_me(manifest))
        writer.add_bytes(archive_manifest.MANIFEST_NAME, manifest.encode())
        writer.add_bytes(archive_manifest.SIGNATURE_NAME, json.dumps(signed, indent=1).encode() + b"\n")
        for one, pieces in self._files:
            writer.add(one.name, one.bytes, pieces())
        writer.close()
        self.fingerprint = fingerprint_of(key)

    def _require_finished(self, connection: sa.Connection) -> Any:
        session = connection.execute(
            sa.select(Session.id, Session.name).where(Session.id == self._session_id)
        ).one_or_none()
        if session is None:  # deleted meanwhile
            raise NotFound.of("session")
        pending = connection.scalar(
            sa.select(sa.func.count()).where(
                Measurement.session_id == self._session_id, Measurement.status.in_(("queued", "running"))
            )
        )
        if pending:
            raise ArchiveRefused(
                "session_unfinished",
                f"{pending} images of the session are not measured yet.",
                "Wait until they are (`gridpose sessions list`), then archive it.",
            )
        return session

    def _read_rows(self, connection: sa.Connection, table: type[Table]) -> None:
        spooled = tempfile.SpooledTemporaryFile(max_size=PIECE, dir=str(self._folder))  # noqa: SIM115
        content = self._held.enter_context(spooled)
        digest, size, count = hashlib.sha256(), 0, 0
        for row in archived_rows(connection, table, self._session_id):
            line = encode_row(table, row)
            digest.update(line)
            size += content.write(line)
            count += 1
        content.seek(0)
        self._rows[table.__tablename__] = count
        one = ArchivedFile(f"rows/{table.__tablename__}.jsonl", size, digest.hexdigest())
        self._files.append((one, partial(_pieces, content)))

    def _find_originals(self, connection: sa.Connection) -> None:
        """Note the originals that are whole; the others are named as missing."""
        named = connection.execute(
            sa.select(Measurement.sha256, Measurement.bytes, Measurement.image_format)
            .where(Measurement.session_id == self._session_id)
            .distinct()
            .order_by(Measurement.sha256)
        )
        for sha256, size, image_format in named:
            if not self._installation.blobs.is_whole(sha256, size):
                self._missing.append(sha256)
                continue
            name = f"originals/{sha256}.{_EXTENSIONS.get(image_format, 'img')}"
            self._files.append((ArchivedFile(name, size, sha256), partial(self._original, sha256, size)))

    def _original(self, sha256: str, size: int) -> Iterator[bytes]:
        try:
            with self._installation.blobs.open(sha256, size) as original:
                yield from _pieces(original)
        except OriginalMissing as error:
            with self._installation.database.read() as records:
                # Deleted meanwhile, and its images with it?
                if records.get(Session, self._session_id) is None:
                    raise NotFound.of("session") from error
            raise

    def _find_reports(self, connection: sa.Connection) -> None:
        """Note the reports' forms and signatures, which never change: they are read when they are written."""
        made = (Report.session_id == self._session_id, Report.status == "succeeded")
        for report_id, form, sha256, size in connection.execute(
            sa.select(ReportForm.report_id, ReportForm.form, ReportForm.sha256, ReportForm.bytes)
            .join(Report, Report.id == ReportForm.report_id)
            .where(*made)
            .order_by(ReportForm.report_id, ReportForm.form)
        ):
            one = ArchivedFile(f"reports/{report_id}/report.{form}", size, sha256)
            self._files.append((one, partial(self._form, report_id, form)))
        for report_id in connection.scalars(sa.select(Report.id).where(*made).order_by(Report.id)):
            with self._installation.database.read() as records:
                content = read_signature(records, report_id)
            one = ArchivedFile(
                f"reports/{report_id}/report.sig", len(content), hashlib.sha256(content).hexdigest()
            )
            self._files.append((one, partial(iter, (content,))))

    def _form(self, report_id: str, form: str) -> Iterator[bytes]:
        with self._installation.database.read() as records:
            content, _ = read_form(records, report_id, form)
        yield content


def _pieces(file: IO[bytes]) -> Iterator[bytes]:
    while piece := file.read(PIECE):
        yield piece
