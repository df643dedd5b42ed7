"""A recording, or several, as the diagnosis takes them: arrays by stage, the nominal machine, the findings."""
