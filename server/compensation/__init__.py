"""A diagnosed machine in the server: its sag, play, offsets and dead bands taken into account. Off by default."""
