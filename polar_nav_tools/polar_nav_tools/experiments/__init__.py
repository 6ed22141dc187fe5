"""The paper's experiments, offline: a simulated world as arrays, configurations side by side."""
