"""docs/reference.md, made from the code: what it lists is what there is."""
