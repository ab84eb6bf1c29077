"""HTTP client of the service: images of a folder to measurements of a session.

`files` assigns images to poses and cycles, `http` sends requests and retries them, `upload` sends images and collects
results, `summary` puts them in a sentence, `resources` finds sessions, targets and robots by name. This package imports
its own modules relatively and nothing else of ours, so that it can be installed alone. It runs on Windows and Linux.
"""

from .files import FilePlan, ImageFile, PatternError, Skipped, plan_files
from .http import ClientError, Json, ServiceClient
from .resources import find_or_make_session, find_or_make_target, find_robot, find_session
from .summary import describe_measured, is_measured, session_cameras
from .upload import SessionResult, UploadResult, collect_results, upload_files

__all__ = [
    "ClientError",
    "FilePlan",
    "ImageFile",
    "Json",
    "PatternError",
    "ServiceClient",
    "SessionResult",
    "Skipped",
    "UploadResult",
    "collect_results",
    "describe_measured",
    "find_or_make_session",
    "find_or_make_target",
    "find_robot",
    "find_session",
    "is_measured",
    "plan_files",
    "session_cameras",
    "upload_files",
]
