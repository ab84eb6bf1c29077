"""The OpenAPI document, made once for each module."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from app.main import create_app
from app.settings import Settings


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    """The document, made without a data folder."""
    app = create_app(Settings(data_dir=Path("/nonexistent/gridpose")))
    return app.openapi()
