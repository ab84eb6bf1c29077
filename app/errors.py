"""What the service refuses, as one tree; it knows nothing of HTTP statuses (`http/statuses.py` has that table).

ServiceError                       code, detail, advice, errors [(field, message)]
├── NotAuthenticated               not_authenticated
├── NotAllowed                     insufficient_scope, key_limited_to_sessions, foreign_host, foreign_origin
├── NotFound                       <noun>_not_found
│   └── OriginalMissing            original_missing
├── Conflict                       conflict, measurement_in_progress, commanded_pose_conflict,
│   │                              image_already_at_pose, target_in_use, robot_in_use,
│   │                              analysis_too_large, too_many_measured_poses, ...
│   ├── OriginalCorrupt            original_corrupt
│   └── RowUnreadable              row_unreadable
├── InvalidContent                 invalid_request, hash_mismatch, referenced_target_not_found, ...
├── PreconditionFailed             precondition_failed
├── UnsupportedContent             unsupported_media_type, unsupported_image
│   └── ContentEncoded             content_encoding_unsupported
├── TooLarge                       body_too_large, upload_too_large
├── QuotaExceeded                  quota_exceeded
├── StorageFull                    storage_full
└── Unavailable                    unavailable, busy, analysis_interrupted, too_many_streams, database_unavailable,
    │                              database_damaged, storage_unavailable, storage_refused
    └── StorageUnusable            storage_unavailable

What a command refuses its operator is another tree, which never reaches HTTP:

OperationRefused                   code, detail, advice
├── InstallationRefused            installation_missing, installation_mismatch, installation_not_in_folder,
│                                  installation_not_in_database, originals_elsewhere, pepper_missing, pepper_changed,
│                                  restore_incomplete, schema_not_current, installation_moved, clock_skewed,
│                                  database_pooled, bucket_missing, bucket_refused, bucket_unreachable,
│                                  bucket_not_conditional
├── BackupRefused                  backup_folder_in_use, backup_folder_unusable, backup_in_data_folder, backup_foreign,
│                                  backup_newer, backup_incomplete, backup_damaged, database_damaged,
│                                  backup_too_new, restore_not_empty, service_running, no_room,
│                                  nothing_to_move, copy_differs
└── ArchiveRefused                 archive_damaged, archive_too_new, archive_conflict, archive_foreign,
                                   archive_exists, archive_unwritable, session_ambiguous, session_unfinished,
                                   session_present, no_room

docs/errors.md lists every code with its cause and remedy.
"""

from __future__ import annotations

import errno
from collections.abc import Sequence

_NO_ROOM = {errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)}
_UNUSABLE = {errno.EACCES, errno.EPERM, errno.EROFS, errno.EIO, errno.ENODEV, errno.ENXIO}
_UNUSABLE |= {getattr(errno, name) for name in ("ESTALE", "ENOTCONN", "EREMOTEIO") if hasattr(errno, name)}
_BUSY = {errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EAGAIN}


class ServiceError(Exception):
    """Base of everything the service refuses on purpose."""

    code = "service_error"
    retry_after_s: int | None = None

    def __init__(
        self,
        detail: str,
        advice: str | None = None,
        *,
        code: str | None = None,
        errors: Sequence[tuple[str, str]] = (),
        retry_after_s: int | None = None,
    ) -> None:
        super().__init__(detail)
        self.detail = detail
        self.advice = advice
        self.code = code if code is not None else type(self).code
        self.errors = tuple(errors)
        self.retry_after_s = retry_after_s if retry_after_s is not None else type(self).retry_after_s
        """When the same request may succeed, seconds from now, where that is known."""


class NotAuthenticated(ServiceError):
    code = "not_authenticated"


class NotAllowed(ServiceError):
    code = "insufficient_scope"


class NotFound(ServiceError):
    code = "not_found"

    @classmethod
    def of(cls, noun: str) -> NotFound:
        """Say that there is no such `noun`, without echoing what was asked for."""
        return cls(
            f"There is no such {noun}.", "Check the id; lists show what exists.", code=f"{noun}_not_found"
        )


class Conflict(ServiceError):
    code = "conflict"


class OriginalMissing(NotFound):
    """The file of an image is gone from the server's disk."""

    code = "original_missing"

    def __init__(self, detail: str = "The stored image is gone from the server's disk.") -> None:
        super().__init__(detail, "Upload the same image again: that puts it back, and it is measured again.")


class OriginalCorrupt(Conflict):
    """The file of an image no longer holds the bytes that were uploaded, or cannot be read."""

    code = "original_corrupt"

    def __init__(
        self, detail: str = "The stored image no longer has the SHA-256 it was uploaded with."
    ) -> None:
        super().__init__(
            detail,
            "Upload the same image again: that replaces the bad file, and it is measured again. Then have the server's "
            "disk checked.",
        )


class RowUnreadable(Conflict):
    """A stored row holds what its table does not allow; nothing but that row is affected."""

    code = "row_unreadable"

    def __init__(self, noun: str, columns: Sequence[str], advice: str | None = None) -> None:
        super().__init__(
            f"What is stored of this {noun} cannot be read: {', '.join(columns)}.",
            advice or "Restore the database from a backup, or delete the row and store it anew.",
        )


class InvalidContent(ServiceError):
    code = "invalid_request"


class PreconditionFailed(ServiceError):
    code = "precondition_failed"


class UnsupportedContent(ServiceError):
    code = "unsupported_media_type"


class ContentEncoded(UnsupportedContent):
    code = "content_encoding_unsupported"


class TooLarge(ServiceError):
    code = "body_too_large"


class QuotaExceeded(ServiceError):
    """A key has sent what it may; `retry_after_s` is when it may send again, seconds from now."""

    code = "quota_exceeded"


class StorageFull(ServiceError):
    code = "storage_full"
    retry_after_s = 5

    def __init__(self, detail: str = "There is no room to store this.") -> None:
        super().__init__(
            detail, "Free disk space on the server; nothing was kept of this request, so send it again."
        )


class Unavailable(ServiceError):
    code = "unavailable"
    retry_after_s = 5


class StorageUnusable(Unavailable):
    """A file or folder of the installation is closed to the service's user, read-only, or on a failing disk."""

    code = "storage_unavailable"

    def __init__(self, detail: str = "The server cannot use its data folder.") -> None:
        super().__init__(
            detail,
            "On the server, run `gridpose doctor`: it names the file. Check its owner, and that its disk is mounted, "
            "writable and sound.",
        )

    @classmethod
    def of(cls, error: OSError) -> StorageUnusable:
        """Say what the system said; not of which path, which clients have no use for."""
        return cls(f"The server cannot use its data folder: {error.strerror or type(error).__name__}.")


def refusal_of(error: OSError) -> ServiceError | None:
    """Return what the service answers where the system refused a call; None where nobody foresaw that.

    A full disk, too much at once, or files that the service's user or the disk does not let it use.
    """
    if error.errno in _NO_ROOM:
        return StorageFull()
    if error.errno in _BUSY:
        return Unavailable("The server has too much to do at once.", "Try again shortly.", code="busy")
    if error.errno in _UNUSABLE:
        return StorageUnusable.of(error)
    return None


class OperationRefused(Exception):
    """Base of what a command refuses the operator."""

    def __init__(self, code: str, detail: str, advice: str) -> None:
        super().__init__(detail)
        self.code = code
        self.detail = detail
        self.advice = advice


class InstallationRefused(OperationRefused):
    """Data folder, database and pepper do not belong together, or are not there."""


class BackupRefused(OperationRefused):
    """A backup cannot be made, or not be restored."""


class ArchiveRefused(OperationRefused):
    """A session cannot be archived, or not be restored from an archive."""
