"""Schemas of documents that are kept for good: reports and qualifications."""
