"""REST under load: readers of events and many questions for the state, while vision works and the machine moves."""
