"""Several nodes that share a Redis: who has a session, the way to it, and taking it up when its node is gone."""
