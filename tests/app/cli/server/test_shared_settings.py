"""What is no address of a database or bucket is refused in a sentence."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from app.settings import Settings


@pytest.mark.parametrize(
    "url",
    [
        "postgresql+psycopg:/rubbish",
        "postgresql+psycopg://host",
        "mysql://host/name",
        "postgres://u@h/n",
        "x",
    ],
)
def test_a_database_s_address_names_a_server_and_a_database(url: str) -> None:
    with pytest.raises(ValidationError, match="user@host/name"):
        Settings(database_url=url)


@pytest.mark.parametrize(
    "url", ["http://rubbish", "s3://", "s3://UPPER/x", "s3://bucket/a b", "bucket/prefix"]
)
def test_a_bucket_s_address_names_a_bucket(url: str) -> None:
    with pytest.raises(ValidationError, match="s3://bucket/prefix"):
        Settings(blob_url=url)


def test_addresses_that_are_right() -> None:
    for url in (
        "postgresql+psycopg://u:p@h:5432/n?sslmode=require",
        "postgresql+psycopg:///n?host=/run",
        "sqlite:////x/y",
    ):
        assert Settings(database_url=url).database_url == url
    for url in ("s3://bucket", "s3://bucket/", "s3://my-bucket.x/a/b_c"):
        assert Settings(blob_url=url).blob_url == url
