"""Analyses for pages: the documents of the API, or why one cannot be made."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from fastapi import Request

from app.analyses.outcome import AnalysisRefused
from app.errors import Conflict
from app.http import get_requester, run_while_connected
from app.web.service import service_of

REPEATABILITY = {"estimator": "pooled", "source": "images"}
"""The settings that `GET .../repeatability` has by default: the same question, the same answer in the cache."""


async def analysis_document(
    request: Request, analysis: str, session_id: str, settings: Mapping[str, str]
) -> dict[str, Any] | AnalysisRefused:
    """Return an analysis of the session as it is now, or why it cannot be made.

    Raises as `AnalysisService.answer` does, but for Conflict; a reader who leaves ends the computation.
    """
    service = service_of(request)
    try:
        answer = await run_while_connected(
            request,
            service.analyses.answer(
                service.installation,
                analysis,
                session_id,
                settings,
                frozenset(),
                await get_requester(request),
            ),
        )
    except Conflict as refused:
        return AnalysisRefused(refused.code, refused.detail, refused.advice or "")
    assert answer.body is not None, "no tag was known"
    document: dict[str, Any] = json.loads(answer.body)
    return document
