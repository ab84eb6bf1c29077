"""Analyses for pages: the documents of the API, or why one cannot be made."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from typing import Any

import sqlalchemy as sa
from fastapi import Request
from starlette.concurrency import run_in_threadpool

from app.analyses.outcome import AnalysisRefused
from app.errors import Conflict
from app.http import get_requester, run_while_connected
from app.records.tables import MeasuredPose, Measurement, Robot, Session, Target
from app.services.queries import visible
from app.web.service import service_of

REPEATABILITY = {"estimator": "pooled", "source": "images"}
"""The settings that `GET .../repeatability` has by default: the same question, the same answer in the cache."""

_ID = re.compile(r"\b(mea|mpo|rob|ses|tgt)_[0-9a-z]{26}\b")
_COLUMNS = sa.select(Measurement.id, Measurement.pose_id, Measurement.cycle, Measurement.filename)
_NAMED: dict[str, Any] = {"rob": Robot, "ses": Session, "tgt": Target}
MAX_NAMED = 500
"""Rows that a page names: those of its sentences, and the first of a list of what is excluded."""


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
    """Return what the images are called that an analysis speaks of: by pose and cycle, with their files."""
    if isinstance(found, AnalysisRefused):
        texts = [found.detail, found.advice or ""]
    else:
        texts = [text or "" for one in found["warnings"] for text in (one["detail"], one["advice"])]
        groups = found.get("groups") or ()
        texts += [image["measurement_id"] for one in groups for image in one.get("highest_residuals") or ()]
        texts += [
            one.get(key) or ""
            for one in found.get("excluded") or ()
            for key in ("measurement_id", "measured_pose_id")
        ]
    return await names_in(request, texts)


async def names_in(request: Request, texts: Iterable[str]) -> dict[str, str]:
    """Return what the images, readings, targets, sessions and robots are called whose ids are in these texts."""
    ids = list(dict.fromkeys(match[0] for match in _ID.finditer(" ".join(texts))))[:MAX_NAMED]
    return await run_in_threadpool(_names, request, ids) if ids else {}


def image_name(pose_id: str, cycle: int | None, filename: str | None) -> str:
    """Return what an image is called: files of different poses may have one name."""
    return pose_id + (f", cycle {cycle}" if cycle else "") + (f" ({filename})" if filename else "")


def _names(request: Request, ids: list[str]) -> dict[str, str]:
    of = {kind: [one for one in ids if one.startswith(kind)] for kind in {one[:3] for one in ids}}
    names: dict[str, str] = {}
    with service_of(request).installation.database.read() as records:
        for row in records.execute(_COLUMNS.where(Measurement.id.in_(of.get("mea", ())))):
            names[row.id] = image_name(row.pose_id, row.cycle, row.filename)
        for reading in records.scalars(sa.select(MeasuredPose).where(MeasuredPose.id.in_(of.get("mpo", ())))):
            names[reading.id] = image_name(reading.pose_id, reading.cycle, None)
        for kind, table in _NAMED.items():
            wanted = sa.select(table.id, table.name).where(table.id.in_(of.get(kind, ())), *visible(table))
            names |= {one.id: one.name for one in records.execute(wanted)} if kind in of else {}
    return names
