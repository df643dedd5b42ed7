"""`longreach bench video`: frames that reach viewers, their age on the screen, and what vision pays for it."""
