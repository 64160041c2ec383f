"""The HTTP calls and the WebSocket handshake."""
