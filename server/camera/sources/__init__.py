"""Where stereo pairs come from: one contract, one file per kind of source."""
