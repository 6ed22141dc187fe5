"""The recorder: messages as they arrive, into a bag."""
