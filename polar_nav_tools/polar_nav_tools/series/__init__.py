"""Series of one vehicle as arrays, from a bag or a replay: input of scoring and report."""
