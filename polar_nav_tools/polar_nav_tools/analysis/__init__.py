"""From a bag to figures: runs are replayed, scored, counted and drawn."""
