"""Units of work, computed by workers, kept on disk."""
