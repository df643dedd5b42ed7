"""Everything the nominal machine leaves out: one file an effect, one compiled kernel, exact identity at neutral."""
