"""What can go wrong with a loop of real nodes."""


class LiveError(RuntimeError):
    """The loop could not run to its end; the message says which node failed and why."""
