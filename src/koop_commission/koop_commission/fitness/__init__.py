"""Whether a rig is fit to be commissioned. Pure."""
