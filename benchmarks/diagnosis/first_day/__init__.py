"""`longreach bench first-day`: sealed machines that nobody has measured, diagnosed without a baseline, and scored."""
