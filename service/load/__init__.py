"""Drives a service with real frames and measures it."""
