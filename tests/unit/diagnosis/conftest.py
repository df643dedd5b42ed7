"""Helpers of this folder are found from all of its subfolders: pytest puts a conftest's own folder on the path."""
