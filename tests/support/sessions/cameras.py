"""Requests for the camera of a session."""

from __future__ import annotations

from typing import Any


def get(api: Any, session: str, **query: Any) -> Any:
    return api.client.get(f"/v1/sessions/{session}/intrinsics", params=query)
