"""What a bag says about one vehicle, as arrays: the common language of scoring and report."""
