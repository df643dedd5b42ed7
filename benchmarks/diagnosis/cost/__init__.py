"""What a diagnosis costs, and that it is the same wherever it is made."""
