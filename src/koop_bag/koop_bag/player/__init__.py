"""The player: a bag's messages out again, at one of four paces."""
