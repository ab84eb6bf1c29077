"""docker/compose.scale.yml sets what the program knows, and lets everything end in order."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from app.settings import Settings

COMPOSITION = Path(__file__).parents[2] / "docker" / "compose.scale.yml"


def test_services_and_workers_share_one_installation() -> None:
    loaded: dict[str, Any] = yaml.safe_load(COMPOSITION.read_text(encoding="utf-8"))
    ours = {name: one for name, one in loaded["services"].items() if one.get("image") == "gridpose"}
    assert set(ours) == {"head-1", "head-2", "worker"}
    known = {f"GRIDPOSE_{name.upper()}" for name in Settings.model_fields}
    for one in ours.values():
        named = {name for name in one["environment"] if name.startswith("GRIDPOSE_")}
        assert named <= known
        assert {"GRIDPOSE_DATABASE_URL", "GRIDPOSE_BLOB_URL", "GRIDPOSE_KEY_PEPPER"} <= named
    shared = [one["environment"]["GRIDPOSE_BLOB_URL"] for one in ours.values()]
    assert len(set(shared)) == 1
    Settings(blob_url=shared[0])
    assert ours["worker"]["command"] == ["gridpose", "worker"]
