"""`longreach bench gap`: the blind benchmark of the gap diagnosis. Its generator and judge live under tests/."""
