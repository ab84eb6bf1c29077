"""Commands on reports that need the service's packages."""
