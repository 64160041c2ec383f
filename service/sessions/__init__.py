"""The registry of sessions: who owns what, where it lives, what it has seen, when it ends."""
