"""From what a sensor or a modem delivers to what the filter can use."""
