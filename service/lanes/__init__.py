"""Worker processes that do all pixel work, reached through :class:`~service.lanes.interface.Lanes`."""
