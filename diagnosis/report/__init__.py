"""The answer for people: a few lines for a terminal, a page for a colleague."""
