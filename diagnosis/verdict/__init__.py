"""From the answers of the cells to one answer: probabilities, equals, how far the gap closes, the word."""
