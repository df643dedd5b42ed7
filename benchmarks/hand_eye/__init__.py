"""Evidence for the hand-eye methods: `longreach bench hand-eye`."""
