"""Of the server: clients beside a moving machine, many jobs, hold-to-run in a browser."""
