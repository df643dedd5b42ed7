"""Does a diagnosed machine position better? Its effects come from recordings of that machine, never from the truth."""
