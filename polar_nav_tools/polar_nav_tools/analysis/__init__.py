"""Analysis of a bag: its runs replayed, scored, counted and drawn."""
