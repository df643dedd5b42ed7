"""The check list for one machine before it is trusted: guided, measured, and written down."""
