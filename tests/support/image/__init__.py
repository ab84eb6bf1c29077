"""Images in files of every kind, mutated views of targets, and figures as plotted."""
