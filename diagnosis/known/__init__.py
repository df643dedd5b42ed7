"""What is known of a machine's baseline beyond its effects: its form, and how its numbers wander."""
