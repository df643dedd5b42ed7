"""Cells made of a recording: each stage and joint, and all that was measured behind the encoders together."""
