"""Layers around the routes, outermost first: requests, loopback, compression, authentication."""
