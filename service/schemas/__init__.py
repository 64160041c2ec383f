"""The protocol's shapes, once: what bodies and messages are checked with and both contracts are made of."""
