"""Plots as SVG. Each module has the plain values one plot shows, and the function that draws them.

matplotlib is loaded by the process that draws, never by the one that serves.
"""
