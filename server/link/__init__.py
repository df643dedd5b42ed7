"""The link to the PLC: a process of its own that speaks UDP (process.py), and the server's handle on it (client.py)."""
