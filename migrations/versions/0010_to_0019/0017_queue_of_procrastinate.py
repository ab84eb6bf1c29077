"""On PostgreSQL: Procrastinate's queue, filled by the rows themselves; news of sessions; answers of analyses.

SQLite keeps its queue in the rows alone and gets nothing new.

Revision: 0017, after 0016
"""

from __future__ import annotations

from pathlib import Path

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None
lost_on_the_way_down = (
    "On PostgreSQL the queue of Procrastinate and kept answers of analyses; the rows say what is queued."
)

_SCHEMA = Path(__file__).parents[2] / "sql" / "procrastinate_3_10_0.sql"

# Fairness by virtual time: a session's next image has the turn after its last one, and none before the turn that is
# being served. Priority is the negative turn, since Procrastinate takes the highest priority first.
_QUEUE_IMAGES = """
CREATE FUNCTION queue_images(wanted text[]) RETURNS void LANGUAGE plpgsql AS $$
DECLARE
    served bigint;
    latest bigint;
    of_session record;
    before_first bigint;
BEGIN
    SELECT last_value INTO latest FROM queue_clock;
    SELECT -priority INTO served FROM procrastinate_jobs
        WHERE status = 'todo' AND queue_name = 'images' ORDER BY priority DESC, id LIMIT 1;
    IF served IS NULL THEN
        IF latest > 1000000000 THEN  -- priorities have 32 bits: begin again while nothing waits
            DELETE FROM queue_turns;
            PERFORM setval('queue_clock', 0);
            latest := 0;
        END IF;
        served := latest;
    END IF;
    FOR of_session IN
        SELECT session_id, count(*) AS images FROM measurements
        WHERE id = ANY(wanted) GROUP BY session_id ORDER BY session_id
    LOOP
        INSERT INTO queue_turns AS turns (session_id, last)
            VALUES (of_session.session_id, served + of_session.images)
            ON CONFLICT (session_id) DO UPDATE SET last = greatest(turns.last, served) + of_session.images
            RETURNING last - of_session.images INTO before_first;
        INSERT INTO procrastinate_jobs (queue_name, task_name, priority, queueing_lock, args)
            SELECT 'images', 'measure', -(before_first + row_number() OVER (ORDER BY id)), id,
                jsonb_build_object('measurement_id', id)
            FROM measurements WHERE id = ANY(wanted) AND session_id = of_session.session_id
            ON CONFLICT (queueing_lock) WHERE status = 'todo' DO NOTHING;
        latest := greatest(latest, before_first + of_session.images);
    END LOOP;
    IF latest > (SELECT last_value FROM queue_clock) THEN
        PERFORM setval('queue_clock', latest);
    END IF;
END $$
"""

_INSERTED = """
CREATE FUNCTION measurements_inserted() RETURNS trigger LANGUAGE plpgsql AS $$
DECLARE
    wanted text[] := ARRAY(SELECT id FROM written WHERE status = 'queued');
BEGIN
    IF cardinality(wanted) > 0 THEN PERFORM queue_images(wanted); END IF;
    PERFORM pg_notify('gridpose', session_id) FROM (SELECT DISTINCT session_id FROM written) AS news;
    RETURN NULL;
END $$
"""

_UPDATED = """
CREATE FUNCTION measurements_updated() RETURNS trigger LANGUAGE plpgsql AS $$
DECLARE
    wanted text[] := ARRAY(
        SELECT written.id FROM written JOIN former USING (id)
        WHERE written.status = 'queued' AND former.status <> 'queued'
    );
BEGIN
    IF cardinality(wanted) > 0 THEN PERFORM queue_images(wanted); END IF;
    PERFORM pg_notify('gridpose', session_id) FROM (SELECT DISTINCT session_id FROM written) AS news;
    RETURN NULL;
END $$
"""

_DELETED = """
CREATE FUNCTION rows_deleted() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    PERFORM pg_notify('gridpose', session_id) FROM (SELECT DISTINCT session_id FROM former) AS news;
    RETURN NULL;
END $$
"""

_SESSION_DELETED = """
CREATE FUNCTION session_deleted() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    PERFORM pg_notify('gridpose', OLD.id);
    RETURN NULL;
END $$
"""

# A key that is revoked ends what it follows: every stream looks again.
_KEY_CHANGED = """
CREATE FUNCTION key_changed() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    PERFORM pg_notify('gridpose', '');
    RETURN NULL;
END $$
"""

_TRIGGERS = (
    "CREATE TRIGGER measurements_inserted AFTER INSERT ON measurements REFERENCING NEW TABLE AS written "
    "FOR EACH STATEMENT EXECUTE FUNCTION measurements_inserted()",
    "CREATE TRIGGER measurements_updated AFTER UPDATE ON measurements "
    "REFERENCING OLD TABLE AS former NEW TABLE AS written "
    "FOR EACH STATEMENT EXECUTE FUNCTION measurements_updated()",
    "CREATE TRIGGER measurements_deleted AFTER DELETE ON measurements REFERENCING OLD TABLE AS former "
    "FOR EACH STATEMENT EXECUTE FUNCTION rows_deleted()",
    "CREATE TRIGGER session_deleted AFTER DELETE ON sessions FOR EACH ROW EXECUTE FUNCTION session_deleted()",
    "CREATE TRIGGER key_changed AFTER UPDATE OF revoked_at, expires_at ON api_keys "
    "FOR EACH STATEMENT EXECUTE FUNCTION key_changed()",
)
_FUNCTIONS = (
    "measurements_inserted()",
    "measurements_updated()",
    "rows_deleted()",
    "session_deleted()",
    "key_changed()",
    "queue_images(text[])",
)


def _is_postgresql() -> bool:
    return op.get_bind().dialect.name == "postgresql"


def upgrade() -> None:
    if not _is_postgresql():
        return
    op.execute(sa.text(_SCHEMA.read_text(encoding="utf-8")))
    op.create_table(
        "queue_turns",
        sa.Column("session_id", sa.String(length=40), nullable=False),
        sa.Column("last", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(
            ["session_id"],
            ["sessions.id"],
            name=op.f("fk_queue_turns_session_id_sessions"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("session_id", name=op.f("pk_queue_turns")),
    )
    op.execute("CREATE SEQUENCE queue_clock MINVALUE 0 START 0")
    # Unlogged: answers can be computed again, so that they need not survive a crash of the server.
    op.create_table(
        "analysis_answers",
        sa.Column("session_id", sa.String(length=40), nullable=False),
        sa.Column("question", sa.String(length=64), nullable=False),
        sa.Column("etag", sa.String(length=64), nullable=False),
        sa.Column("body", sa.LargeBinary(), nullable=True),
        sa.Column("refusal", sa.JSON(), nullable=True),
        sa.Column("bytes", sa.BigInteger(), nullable=False),
        sa.Column("used_at", sa.DateTime(timezone=True), server_default=sa.func.now(), nullable=False),
        sa.ForeignKeyConstraint(
            ["session_id"],
            ["sessions.id"],
            name=op.f("fk_analysis_answers_session_id_sessions"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("session_id", "question", name=op.f("pk_analysis_answers")),
        prefixes=["UNLOGGED"],
    )
    op.create_index("ix_analysis_answers_used_at", "analysis_answers", ["used_at"])
    for function in (_QUEUE_IMAGES, _INSERTED, _UPDATED, _DELETED, _SESSION_DELETED, _KEY_CHANGED):
        op.execute(sa.text(function))
    for trigger in _TRIGGERS:
        op.execute(trigger)
    # What the former queue left: images that were being computed are computed again.
    op.execute("UPDATE measurements SET status = 'running', claim = NULL WHERE status = 'queued'")
    op.execute("UPDATE measurements SET status = 'queued', claim = NULL WHERE status = 'running'")


def downgrade() -> None:
    if not _is_postgresql():
        return
    for name in ("measurements_inserted", "measurements_updated", "measurements_deleted"):
        op.execute(f"DROP TRIGGER {name} ON measurements")
    op.execute("DROP TRIGGER session_deleted ON sessions")
    op.execute("DROP TRIGGER key_changed ON api_keys")
    for function in _FUNCTIONS:
        op.execute(f"DROP FUNCTION {function}")
    op.drop_table("analysis_answers")
    op.drop_table("queue_turns")
    op.execute("DROP SEQUENCE queue_clock")
    op.execute(
        "DROP TABLE procrastinate_events, procrastinate_periodic_defers, procrastinate_jobs, procrastinate_workers "
        "CASCADE"
    )
    # What is left are its functions and types, all of which begin with its name.
    op.execute(
        sa.text(
            """
DO $$
DECLARE
    object record;
BEGIN
    FOR object IN SELECT oid::regprocedure AS name FROM pg_proc
        WHERE proname LIKE 'procrastinate!_%' ESCAPE '!' AND pronamespace = current_schema()::regnamespace
    LOOP
        EXECUTE format('DROP FUNCTION %s CASCADE', object.name);
    END LOOP;
    FOR object IN SELECT oid::regtype AS name FROM pg_type
        WHERE typname LIKE 'procrastinate!_%' ESCAPE '!' AND typtype IN ('e', 'c')
            AND typnamespace = current_schema()::regnamespace
    LOOP
        EXECUTE format('DROP TYPE %s CASCADE', object.name);
    END LOOP;
END $$
"""
        )
    )
