"""The client's command line: one folder a noun, `table` lists every command, `main` runs them.

The commands of the service (`app.cli`) use what is shared: consoles, options, files of records.
"""

from typing import TYPE_CHECKING

from ..lazy_face import lazy_face

if TYPE_CHECKING:
    from .access import (
        RETRY_FOR_S,
        AdminAccess,
        KeyFile,
        ReadAccess,
        UploadAccess,
        UploadKey,
        open_client,
        print_refusal,
    )
    from .console import (
        OptionRefused,
        error_console,
        fail,
        output_console,
        print_error,
        print_json,
        print_list,
    )
    from .images.transfer import transfer, transfer_progress
    from .lazy import LazyCommand, uncollected
    from .main import make_app, run
    from .output_files import print_bytes, write_file
    from .record_files import Record, RecordFormat, Records, as_delimiter, read_mapping, read_records
    from .targets.description import Kind, TargetDescription

_PLACES = {
    ".access": (
        *(
            "RETRY_FOR_S",
            "AdminAccess",
            "KeyFile",
            "ReadAccess",
            "UploadAccess",
            "UploadKey",
            "open_client",
            "print_refusal",
        ),
    ),
    ".console": (
        *(
            "OptionRefused",
            "error_console",
            "fail",
            "output_console",
            "print_error",
            "print_json",
            "print_list",
        ),
    ),
    ".images.transfer": ("transfer", "transfer_progress"),
    ".lazy": ("LazyCommand", "uncollected"),
    ".main": ("make_app", "run"),
    ".output_files": ("print_bytes", "write_file"),
    ".record_files": ("Record", "RecordFormat", "Records", "as_delimiter", "read_mapping", "read_records"),
    ".targets.description": ("Kind", "TargetDescription"),
}
__getattr__, __dir__ = lazy_face(__name__, _PLACES)

__all__ = [
    "RETRY_FOR_S",
    "AdminAccess",
    "KeyFile",
    "Kind",
    "LazyCommand",
    "OptionRefused",
    "ReadAccess",
    "Record",
    "RecordFormat",
    "Records",
    "TargetDescription",
    "UploadAccess",
    "UploadKey",
    "as_delimiter",
    "error_console",
    "fail",
    "make_app",
    "open_client",
    "output_console",
    "print_bytes",
    "print_error",
    "print_json",
    "print_list",
    "print_refusal",
    "read_mapping",
    "read_records",
    "run",
    "transfer",
    "transfer_progress",
    "uncollected",
    "write_file",
]
