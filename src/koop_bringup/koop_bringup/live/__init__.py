"""Starting nodes, watching them, ending them together."""
