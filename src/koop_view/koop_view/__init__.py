"""A page that shows a loop and operates it, over the Foxglove WebSocket protocol."""
