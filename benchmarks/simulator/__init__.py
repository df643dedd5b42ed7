"""Of the simulator: its speed, gains of its controllers, scenes and exact pictures to compare with."""
