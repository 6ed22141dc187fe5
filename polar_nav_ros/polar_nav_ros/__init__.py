"""What every node shares: parameters, subscriptions, lockstep, signals, diagnostics."""
