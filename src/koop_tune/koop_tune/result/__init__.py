"""The result as JSON, text and parameters."""
