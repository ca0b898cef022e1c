"""Listening to a rig over DDS."""
