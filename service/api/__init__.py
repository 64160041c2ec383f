"""HTTP and the WebSocket handshake."""
