"""Replay: recorded states through the controller again, and what it says beside what it said."""
