"""`longreach bench camera-faults`: every camera fault injected, when it is found, and that no look uses it."""
