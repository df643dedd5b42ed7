"""Does the proposed experiment separate what the first recording could not: simulated by a plant of the bench's own."""
