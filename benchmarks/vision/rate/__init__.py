"""`longreach bench vision`: 720p stereo pairs a second to marker poses and odometry, and where the time goes."""
