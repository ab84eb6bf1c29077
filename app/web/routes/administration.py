"""Keys, the audit trail, and the state of the system."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Annotated, Any

import sqlalchemy as sa
from fastapi import Query, Request
from sqlalchemy import orm
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from app.build import core_version
from app.records.database import sqlite_version
from app.records.tables import ApiKey, AuditEntry, Report, Robot, Session, Target
from app.services.keys import list_keys
from app.services.sessions import count_all_measurements
from app.web.health import look
from app.web.pages import page_router, render
from app.web.service import Service, service_of
from app.web.words import CHECK_STATES

router = page_router()
KEYS_PAGE, AUDIT_PAGE, AUDIT_OBJECTS = 200, 100, 3
_NAMED = {"ses": ("session", Session.name), "tgt": ("target", Target.name), "rob": ("robot", Robot.name)}
_NAMED |= {"key": ("key", ApiKey.name), "rep": ("report", Report.title)}
_KINDS = {"mea": "image", "mpo": "measured pose", "eve": "event", "whk": "webhook"}
_KINDS |= {prefix: kind for prefix, (kind, _) in _NAMED.items()}
_ID = re.compile(rf"({'|'.join(_KINDS)})_[0-9a-z]{{26}}")


@router.get("/keys", operation_id="list_keys")
def show_keys(request: Request, cursor: Annotated[str | None, Query(max_length=200)] = None) -> Response:
    """Show the keys, and the form to make one."""
    keys, next_cursor = list_keys(service_of(request).installation, limit=KEYS_PAGE, cursor=cursor)
    return render(request, "administration/keys.html", keys=keys, next_cursor=next_cursor)


@router.get("/audit", operation_id="list_audit")
def show_audit(
    request: Request,
    key: Annotated[str, Query(max_length=64)] = "",
    about: Annotated[str, Query(max_length=128)] = "",
    page: Annotated[int, Query(ge=1, le=1_000_000)] = 1,
) -> Response:
    """Show who changed what, newest first."""
    statement = sa.select(AuditEntry)
    if key.strip():
        named = sa.select(ApiKey.id).where(ApiKey.name.icontains(key.strip(), autoescape=True))
        statement = statement.where(
            sa.or_(
                AuditEntry.key_id == key.strip(),
                AuditEntry.key_id.in_(named),
                AuditEntry.key_name.icontains(key.strip(), autoescape=True),
            )
        )
    if about:
        listed = sa.cast(AuditEntry.object_ids, sa.Text())
        statement = statement.where(listed.contains(f'"{about}"', autoescape=True))
    with service_of(request).installation.database.read() as records:
        entries = records.scalars(
            statement.order_by(AuditEntry.id.desc()).limit(AUDIT_PAGE + 1).offset((page - 1) * AUDIT_PAGE)
        ).all()
        names = _names(records, {one for entry in entries for one in entry.object_ids[:AUDIT_OBJECTS]})
    return render(
        request,
        "administration/audit.html",
        entries=entries[:AUDIT_PAGE],
        objects=AUDIT_OBJECTS,
        names=names,
        more=len(entries) > AUDIT_PAGE,
        page=page,
        filters={"key": key, "about": about},
    )


@router.get("/system", operation_id="get_metrics")
async def show_system(request: Request) -> Response:
    """Show whether the service is well, part by part: in words, and what to do where it is not."""
    service = service_of(request)
    health = await look(request)
    facts = await run_in_threadpool(_facts, service)
    waiting, running = service.analyses.counts()
    runner = service.runner.state if service.runner is not None else None
    return render(
        request,
        "administration/system.html",
        health=health,
        states=CHECK_STATES,
        runner=runner,
        analyses_waiting=waiting,
        analyses_running=running,
        core_version=core_version(),
        **facts,
    )


def _names(records: orm.Session, ids: set[str]) -> dict[str, tuple[str, str]]:
    """Return of ids what they are and their names; images, and what is gone, have none."""
    found = {one: (_KINDS[match[1]], "") for one in ids if (match := _ID.fullmatch(one))}
    for prefix, (kind, name) in _NAMED.items():
        wanted = [one for one in found if one.startswith(prefix)]
        row_id = name.class_.id
        rows = records.execute(sa.select(row_id, name).where(row_id.in_(wanted))) if wanted else ()
        found |= {row[0]: (kind, row[1]) for row in rows}
    return found


def _facts(service: Service) -> dict[str, Any]:
    installation = service.installation
    with installation.database.read() as records:
        counts = count_all_measurements(records)
    folder = installation.settings.data_dir
    disk = shutil.disk_usage(folder)
    backups = sorted((folder / "backups").glob("*")) if (folder / "backups").is_dir() else []
    version, sound = sqlite_version()
    return {
        "counts": counts,
        "disk": disk,
        "floor": installation.settings.disk_floor_bytes,
        "database_bytes": installation.database.size_bytes(),
        "database": f"SQLite {version}" if installation.database.is_sqlite else "PostgreSQL",
        "database_sound": sound or not installation.database.is_sqlite,
        "copies": [Path(one).name for one in backups],
        "retention_days": installation.settings.retention_days,
    }
