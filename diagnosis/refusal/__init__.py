"""Whether the names found leave something behind that has a shape of its own: then none is believed."""
