"""Units of work, computed on all cores, kept on disk."""
