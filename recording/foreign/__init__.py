"""Logs of other systems (ROS bags, tables) as recordings: what was found, what it was taken for, and why."""
