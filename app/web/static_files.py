"""Style, scripts and vendored libraries; their address changes with their content, so that browsers keep them."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from fastapi import APIRouter, Request, Response

from app.errors import NotFound

_FOLDER = Path(__file__).parent / "static"
_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
router = APIRouter(include_in_schema=False)


@cache
def _files() -> dict[str, tuple[bytes, str]]:
    """Return the content and type of every file, by its name below the folder; a few hundred kB."""
    return {
        path.relative_to(_FOLDER).as_posix(): (path.read_bytes(), _TYPES[path.suffix])
        for path in sorted(_FOLDER.rglob("*"))
        if path.suffix in _TYPES
    }


@cache
def static_version() -> str:
    """Return a hash of all files, which is part of their addresses."""
    digest = hashlib.sha256()
    for name, (content, _) in _files().items():
        digest.update(f"{name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:12]


@router.get("/ui/static/{version}/{name:path}")
def get_static_file(request: Request, version: str, name: str) -> Response:
    """Serve one file, kept by browsers for good where the address names its version."""
    if name not in _files():
        raise NotFound.of("file")
    content, media_type = _files()[name]
    tag = f'"{static_version()}"'
    is_current = version == static_version()
    kept = "public, max-age=31536000, immutable" if is_current else "no-cache"
    headers = {"Cache-Control": kept, "ETag": tag}
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers=headers)
    return Response(content, media_type=media_type, headers=headers)
