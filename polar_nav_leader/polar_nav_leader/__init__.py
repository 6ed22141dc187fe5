"""The leader: joins its own navigation with what its array heard, and broadcasts it."""
