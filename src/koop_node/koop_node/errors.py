"""What goes wrong among running nodes."""


class LiveError(RuntimeError):
    """Nodes that run could not do what was asked; the message says which and why."""
