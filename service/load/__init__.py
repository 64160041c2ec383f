"""Driving a service with real frames and measuring it."""
