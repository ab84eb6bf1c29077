"""Targets as sheets of paper: drawn from the same layout data that detection reads them by, written as PDF and SVG."""
