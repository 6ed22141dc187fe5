"""Grid-frame SINS with its 24-state error filter, the stored past, delay handling and noise adaptation."""
