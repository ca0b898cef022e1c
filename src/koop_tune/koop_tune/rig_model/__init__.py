"""A model of the rig from its excitation."""
