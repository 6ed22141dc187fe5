"""The watchdog: what innovations, refusals and silences say of each sensor."""
