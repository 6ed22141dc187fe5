"""Grid-frame SINS with 24-state error filter, stored past, delay handling and noise adaptation."""
