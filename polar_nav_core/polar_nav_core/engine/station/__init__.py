"""Station mode: navigation by a vehicle model and the delayed fixes of a hydroacoustic station."""
