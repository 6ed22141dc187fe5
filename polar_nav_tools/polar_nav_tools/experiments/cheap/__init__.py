"""A vehicle of the BlueROV2 kind: AHRS, DVL, pressure sensor, UGPS, as drivers publish."""
