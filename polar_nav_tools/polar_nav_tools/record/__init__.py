"""The recorder: writes messages into a bag as they arrive."""
