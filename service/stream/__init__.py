"""Frames over a WebSocket: two subprotocols, two flow modes, one attachment a session."""
