"""Client of the service: `from gridpose import Gridpose` where it is installed alone, `app.client` in a checkout.

`images` assigns files to poses and cycles, sends them and collects results, `http` sends requests and retries them,
`summary` puts results in a sentence, `resources` finds sessions, targets and robots by name, `watch` sends what
appears in a folder, `commands` is the command line. This package imports its own modules relatively and nothing else of
ours, so that it can be installed alone under another name. It runs on Windows, macOS and Linux.
"""

from typing import TYPE_CHECKING

from .lazy_face import lazy_face

if TYPE_CHECKING:
    from .async_gridpose import AsyncGridpose, AsyncSession
    from .gridpose import Gridpose, Session
    from .http import ClientError, Json, ServiceClient
    from .images.files import FilePlan, ImageFile, PatternError, Skipped, plan_files
    from .images.upload import SessionResult, UploadResult, collect_results, upload_files
    from .resources import find_or_make_session, find_or_make_target, find_robot, find_session, find_target
    from .results import Analysis, Measurement
    from .summary import describe_measured, is_measured, session_cameras

__version__ = "0.1.0"

_PLACES = {
    ".async_gridpose": ("AsyncGridpose", "AsyncSession"),
    ".gridpose": ("Gridpose", "Session"),
    ".http": ("ClientError", "Json", "ServiceClient"),
    ".images.files": ("FilePlan", "ImageFile", "PatternError", "Skipped", "plan_files"),
    ".images.upload": ("SessionResult", "UploadResult", "collect_results", "upload_files"),
    ".resources": (
        "find_or_make_session",
        "find_or_make_target",
        "find_robot",
        "find_session",
        "find_target",
    ),
    ".results": ("Analysis", "Measurement"),
    ".summary": ("describe_measured", "is_measured", "session_cameras"),
}
__getattr__, __dir__ = lazy_face(__name__, _PLACES)

__all__ = [
    "Analysis",
    "AsyncGridpose",
    "AsyncSession",
    "ClientError",
    "FilePlan",
    "Gridpose",
    "ImageFile",
    "Json",
    "Measurement",
    "PatternError",
    "ServiceClient",
    "Session",
    "SessionResult",
    "Skipped",
    "UploadResult",
    "collect_results",
    "describe_measured",
    "find_or_make_session",
    "find_or_make_target",
    "find_robot",
    "find_session",
    "find_target",
    "is_measured",
    "plan_files",
    "session_cameras",
    "upload_files",
]
