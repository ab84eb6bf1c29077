"""Requests to the service: `ServiceClient`, the address it takes, and what a request may end with."""

from .address import service_address
from .errors import ClientError, Unusable
from .requests import Json, ServiceClient, insisting_query

__all__ = ["ClientError", "Json", "ServiceClient", "Unusable", "insisting_query", "service_address"]
