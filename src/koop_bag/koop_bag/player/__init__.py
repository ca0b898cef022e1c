"""The player: publishes the messages of a bag."""
