"""Options of commands that talk to a service, which the client's commands have, too."""

from __future__ import annotations

from app.client.commands import AdminAccess, ReadAccess, UploadAccess

__all__ = ["AdminAccess", "ReadAccess", "UploadAccess"]
