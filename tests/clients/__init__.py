"""`make check-clients`: the committed openapi.json through the linters and generators that users of it run."""
