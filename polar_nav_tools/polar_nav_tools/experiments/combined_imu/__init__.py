"""GTSAM's CombinedImuFactor as it is shipped, beside our smoother, both against the truth."""
