"""The installation's own row, which binds database and data folder; a hash of every result's arrays.

Revision: 0008, after 0007
"""

from __future__ import annotations

import hashlib

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None
lost_on_the_way_down = (
    "The database's installation id and the check of the key pepper; both are made anew on the way up."
)

_BATCH = 500


def _content_hash(points: bytes | None, markers: bytes | None) -> str:
    """Return what `codec.content_hash` returned when this revision was made."""
    digest = hashlib.sha256()
    for part in (points, markers):
        digest.update((-1 if part is None else len(part)).to_bytes(8, "little", signed=True))
        digest.update(part or b"")
    return digest.hexdigest()


def _fill() -> None:
    results = sa.table(
        "results",
        sa.column("measurement_id", sa.String),
        sa.column("points", sa.LargeBinary),
        sa.column("markers", sa.LargeBinary),
        sa.column("content_sha256", sa.String),
    )
    connection = op.get_bind()
    last = ""
    while rows := connection.execute(
        sa.select(results.c.measurement_id, results.c.points, results.c.markers)
        .where(results.c.measurement_id > last)
        .order_by(results.c.measurement_id)
        .limit(_BATCH)
    ).all():
        connection.execute(
            sa.update(results)
            .where(results.c.measurement_id == sa.bindparam("row"))
            .values(content_sha256=sa.bindparam("sha256")),
            [{"row": row[0], "sha256": _content_hash(row[1], row[2])} for row in rows],
        )
        last = rows[-1][0]


def upgrade() -> None:
    op.create_table(
        "installation",
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("pepper_check", sa.String(length=64), nullable=True),
        sa.CheckConstraint("number = 1", name=op.f("ck_installation_one_row")),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_installation")),
    )
    op.add_column("results", sa.Column("content_sha256", sa.String(length=64), nullable=True))
    _fill()
    with op.batch_alter_table("results", schema=None) as batch_op:
        batch_op.alter_column("content_sha256", existing_type=sa.String(length=64), nullable=False)
    op.create_index("ix_results_content", "results", ["measurement_id", "content_sha256"])


def downgrade() -> None:
    op.drop_index("ix_results_content", table_name="results")
    with op.batch_alter_table("results", schema=None) as batch_op:
        batch_op.drop_column("content_sha256")
    op.drop_table("installation")
