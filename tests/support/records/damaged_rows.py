"""Rows damaged as somebody with the database's own tools does, and what the service then answers."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa

CODE = "row_unreadable"
KUKA = [{"a_mm": 25.0, "alpha_deg": 90.0, "d_mm": 400.0}] * 6


def damage(api: Any, statement: str, **values: Any) -> None:
    """Change rows as somebody with the database's own tools does."""
    with api.installation.database.engine.begin() as connection:
        if api.installation.database.is_sqlite:
            connection.exec_driver_sql("PRAGMA ignore_check_constraints=ON")
        assert connection.execute(sa.text(statement), values).rowcount == 1


def upload(api: Any, grey_png: bytes, orders: str, **session: Any) -> tuple[str, list[str]]:
    session_id = api.make_session(**session)
    ids = []
    for number, order in enumerate(orders):
        response = api.put_image(session_id, grey_png + b"%d" % number + order.encode(), pose_id=f"P{number}")
        assert response.status_code == 202, response.text
        ids.append(response.json()["id"])
    return session_id, ids


def get(api: Any, path: str, status: int = 200) -> Any:
    response = api.client.get(path)
    assert response.status_code == status, response.text
    return response.json()
