"""Many bags, here or at an address: found by patterns, scored as tasks, kept as rows."""
