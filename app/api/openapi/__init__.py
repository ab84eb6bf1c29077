"""The OpenAPI document, in a form that client generators accept, with examples from a real run."""

from app.api.openapi.document import openapi_document
from app.api.openapi.examples import EXAMPLES_PATH

__all__ = ["EXAMPLES_PATH", "openapi_document"]
