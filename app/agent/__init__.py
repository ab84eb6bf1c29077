"""The shop-floor PC's side: files on a disk to measurements in a session, over HTTP and nothing else.

`files` says which image belongs to which pose, `client` speaks to the service and retries, `upload` joins
them. It imports nothing of the service and runs on Windows as on Linux.
"""

from app.agent.client import ClientError, Json, ServiceClient
from app.agent.files import FilePlan, ImageFile, PatternError, Skipped, plan_files
from app.agent.upload import Outcome, SessionResult, collect_results, upload_files

__all__ = [
    "ClientError",
    "FilePlan",
    "ImageFile",
    "Json",
    "Outcome",
    "PatternError",
    "ServiceClient",
    "SessionResult",
    "Skipped",
    "collect_results",
    "plan_files",
    "upload_files",
]
