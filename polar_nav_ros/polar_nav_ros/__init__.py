"""Common parts of all nodes: parameters, subscriptions, lockstep, diagnostics, readers."""
