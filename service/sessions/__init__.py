"""The sessions: who owns them, where their state is, what they have seen, and when they end."""
