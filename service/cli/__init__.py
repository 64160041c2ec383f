"""Subcommands of ``mfcmt`` that need the service."""
