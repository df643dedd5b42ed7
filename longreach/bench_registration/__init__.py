"""Evidence for the registration and hand-eye methods: `longreach bench registration`, `longreach bench hand-eye`."""
