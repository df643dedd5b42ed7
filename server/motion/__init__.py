"""Motion: a wanted pose becomes a timed reference of the joints, or a reason why not. Pure."""
