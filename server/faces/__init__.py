"""Read-only live views for other programs: OPC UA and Foxglove. Off by default, each an extra of its own."""
