"""Evidence for marker poses: noise bound, planar flips, honest covariances."""
