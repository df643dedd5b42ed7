"""Import logs of other systems (ROS bags, tables) as recordings; each guess is reported with its reason."""
