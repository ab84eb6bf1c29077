"""Rows of a database: of every table, and damaged ones."""
