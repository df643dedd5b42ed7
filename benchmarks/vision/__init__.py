"""Of the pictures: rate, odometry, markers, camera faults, memory."""
