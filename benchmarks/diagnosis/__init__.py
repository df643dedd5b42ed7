"""Of the diagnosis: sealed cases, links, experiments, time and memory."""
