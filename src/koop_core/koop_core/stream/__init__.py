"""Streams of messages: arrival, age, losses, findings."""
