"""The service's subcommands of ``mfcmt``."""
