"""Evidence for the stereo odometry: rendered paths, disturbed ones, and covariances over many short simulated runs."""
