"""The follower: a filter that knows when each late fix was valid."""
