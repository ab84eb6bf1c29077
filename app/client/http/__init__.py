"""Requests to the service: `ServiceClient`, the address it takes, and what a request may end with."""

from .address import service_address
from .errors import ArgumentRefused, ClientError
from .requests import Json, ServiceClient, insisting_query

__all__ = ["ArgumentRefused", "ClientError", "Json", "ServiceClient", "insisting_query", "service_address"]
