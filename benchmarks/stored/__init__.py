"""Sections on sessions that are stored: what their analyses, reports and growth cost."""
