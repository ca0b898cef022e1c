"""The stages: check, excite, tune, verify."""
