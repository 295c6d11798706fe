"""The container of a stack: its rim and walls, fitted, configured or taught."""
