"""Commands on the stored reports of a service."""
