"""All effects of one part of the recording fitted together, then pruned: which sets of effects the data support."""
