"""The client's command line: one folder a noun, `table` lists every command, `main` runs them.

The commands of the service (`app.cli`) use what is shared: consoles, options, files of records.
"""

from typing import TYPE_CHECKING

from ..lazy_face import lazy_face

if TYPE_CHECKING:
    from .access import AdminAccess, KeyFile, ReadAccess, UploadAccess, UploadKey
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
    from .lazy import uncollected
    from .main import make_app, run
    from .output_files import print_bytes, write_file
    from .record_files import read_mapping
    from .targets.description import TargetDescription

_PLACES = {
    ".access": ("AdminAccess", "KeyFile", "ReadAccess", "UploadAccess", "UploadKey"),
    ".console": (
        *("OptionRefused", "error_console", "fail", "output_console"),
        *("print_error", "print_json", "print_list"),
    ),
    ".images.transfer": ("transfer", "transfer_progress"),
    ".lazy": ("uncollected",),
    ".main": ("make_app", "run"),
    ".output_files": ("print_bytes", "write_file"),
    ".record_files": ("read_mapping",),
    ".targets.description": ("TargetDescription",),
}
__getattr__, __dir__ = lazy_face(__name__, _PLACES)

__all__ = [
    "AdminAccess",
    "KeyFile",
    "OptionRefused",
    "ReadAccess",
    "TargetDescription",
    "UploadAccess",
    "UploadKey",
    "error_console",
    "fail",
    "make_app",
    "output_console",
    "print_bytes",
    "print_error",
    "print_json",
    "print_list",
    "read_mapping",
    "run",
    "transfer",
    "transfer_progress",
    "uncollected",
    "write_file",
]
