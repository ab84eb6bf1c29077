"""Analyses for pages: the documents of the API, or why one cannot be made."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

import sqlalchemy as sa
from fastapi import Request
from starlette.concurrency import run_in_threadpool

from app.analyses.outcome import AnalysisRefused
from app.errors import Conflict
from app.http import get_requester, run_while_connected
from app.records.tables import Measurement
from app.web.service import service_of

REPEATABILITY = {"estimator": "pooled", "source": "images"}
"""The settings that `GET .../repeatability` has by default: the same question, the same answer in the cache."""

_IMAGE_ID = re.compile(r"\bmea_[0-9a-z]{26}\b")
MAX_NAMED = 200
"""Images that a page names; there are more only where a sentence lists hundreds, which none does."""


async def analysis_document(
    request: Request, analysis: str, session_id: str, settings: Mapping[str, str]
) -> dict[str, Any] | AnalysisRefused:
    """Return an analysis of the session as it is now, or why it cannot be made.

    Raises as `AnalysisService.answer` does, but for Conflict; a reader who leaves ends the computation.
    """
    requester = await get_requester(request)
    asked = service_of(request).analyses.answer(analysis, session_id, settings, frozenset(), requester)
    try:
        answer = await run_while_connected(request, asked)
    except Conflict as refused:
        return AnalysisRefused(refused.code, refused.detail, refused.advice or "")
    assert answer.body is not None, "no tag was known"
    document: dict[str, Any] = json.loads(answer.body)
    return document


async def image_names(request: Request, found: Mapping[str, Any] | AnalysisRefused) -> dict[str, str]:
    """Return what the images are called that an analysis speaks of: by their files, else by pose and cycle."""
    if isinstance(found, AnalysisRefused):
        texts = [found.detail, found.advice or ""]
    else:
        texts = [text or "" for one in found["warnings"] for text in (one["detail"], one["advice"])]
        groups = found.get("groups") or ()
        texts += [image["measurement_id"] for one in groups for image in one.get("highest_residuals") or ()]
    ids = list(dict.fromkeys(_IMAGE_ID.findall(" ".join(texts))))[:MAX_NAMED]
    return await run_in_threadpool(_names, request, ids) if ids else {}


def _names(request: Request, ids: list[str]) -> dict[str, str]:
    columns = sa.select(Measurement.id, Measurement.filename, Measurement.pose_id, Measurement.cycle)
    with service_of(request).installation.database.read() as records:
        return {
            row.id: row.filename or ", ".join([row.pose_id, *([f"cycle {row.cycle}"] if row.cycle else [])])
            for row in records.execute(columns.where(Measurement.id.in_(ids)))
        }
