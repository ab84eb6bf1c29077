"""Applications, runners and processes under test, and databases for them."""
