"""Table of qualifications: what known lengths showed of a set-up, and until when that holds."""

from __future__ import annotations

from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.records.tables.base import JsonObject, Table, made_by_column


class Qualification(Table):
    """One qualification. Triggers refuse to change or delete it.

    It outlives its session and robot, which it names without a reference. `robot_id` null: of the installation;
    `camera_name` is the user's name of the camera. `analysis` is the answer that the figures are from, whole.
    """

    __tablename__ = "qualifications"
    __table_args__ = (
        sa.Index("ix_qualifications_robot_id_id", "robot_id", "id"),
        sa.Index("ix_qualifications_session_id", "session_id"),
    )

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    session_id: Mapped[str] = mapped_column(sa.String(40))
    session_name: Mapped[str] = mapped_column(sa.String(200))
    robot_id: Mapped[str | None] = mapped_column(sa.String(40))
    camera_name: Mapped[str | None] = mapped_column(sa.String(200))
    made_at: Mapped[datetime]
    due_at: Mapped[datetime]
    decision: Mapped[str | None] = mapped_column(sa.String(16))
    maximum_permissible_error_mm: Mapped[float | None] = mapped_column(sa.Double())
    worst_error_mm: Mapped[float] = mapped_column(sa.Double())
    probing_scatter_mm: Mapped[float | None] = mapped_column(sa.Double())
    scale_ppm: Mapped[float] = mapped_column(sa.Double())
    analysis: Mapped[JsonObject] = mapped_column(sa.JSON())
    made_by: Mapped[str | None] = made_by_column()
    made_by_name: Mapped[str | None] = mapped_column(sa.String(200))
