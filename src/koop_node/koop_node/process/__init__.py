"""The process of a node: its domain, its parent, its priority, its memory."""
