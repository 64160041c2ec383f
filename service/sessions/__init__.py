"""The book of sessions: who owns what, where it lives, what it has seen, when it ends."""
