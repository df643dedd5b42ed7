"""Along the chain of driven stages: what is found of one that has to be known before the next is judged."""
