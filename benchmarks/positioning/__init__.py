"""Of positioning: many machines in the fast world, and the whole stack end to end."""
