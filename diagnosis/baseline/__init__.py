"""A machine's usual state, fitted on undisturbed recordings: effects, forms, what searches find there."""
