"""What the launch file decides before it starts a node."""
