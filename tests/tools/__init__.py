"""Commands that try a service hard: ``siege``, ``chaos``, ``fuzz`` and ``soak``. The wheel does not carry them."""
