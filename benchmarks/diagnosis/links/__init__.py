"""Does the diagnosis tell a machine behind a link as links are from one with a fault."""
