"""What to do next with a machine whose diagnosis is not settled: a library, what it would show, what separates most."""
