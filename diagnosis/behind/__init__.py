"""What was measured behind the encoders (points, marker corners, odometry) against the arm."""
