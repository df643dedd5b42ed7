"""One fault schedule of the link in virtual time, with invariants watched in every cycle."""
