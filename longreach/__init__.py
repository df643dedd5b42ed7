"""The command `longreach`: subcommands and the composition of processes; no logic of its own."""
