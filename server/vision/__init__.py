"""Vision: markers, poses with covariance, looks, stereo odometry. Pure: images and time come as arguments."""
