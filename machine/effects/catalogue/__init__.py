"""The catalogue: one file a stage, one entry an effect."""
