"""REST, live channel and panel on one port."""
