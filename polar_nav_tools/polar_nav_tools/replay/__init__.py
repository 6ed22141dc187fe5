"""A recorded bag through the follower's engine: by message or by arrays, verified."""
