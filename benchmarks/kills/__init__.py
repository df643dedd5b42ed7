"""SIGKILL in the middle of a move: of the server, of its link process, of the PLC; measured on the PLC's own clock."""
