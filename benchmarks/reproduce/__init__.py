"""The paper's tables and figures beside ours: its data, a fast world without images, and the cases run in it."""
