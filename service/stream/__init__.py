"""A stream's connection: one task reads messages and queues frames, another has them tracked and answers."""
