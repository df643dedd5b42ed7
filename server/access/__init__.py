"""Who may command the machine: the lease of control, keys and roles. Pure but for the desk's clock and the key file."""
