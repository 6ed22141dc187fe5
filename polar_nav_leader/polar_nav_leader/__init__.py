"""The leader: joins its own navigation with its array's readings, and broadcasts fixes."""
