"""Live view for Foxglove: read-only, off by default."""
