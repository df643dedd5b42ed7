"""What is known of an undisturbed machine beyond its named effects: its form, and how its numbers wander."""
