"""The recorder: every topic of a run into a bag."""
