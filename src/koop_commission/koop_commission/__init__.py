"""From an unknown rig to a damped one: check, excite, tune, verify, report."""
