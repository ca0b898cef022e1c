"""The guard of a rig: it alone commands theta, and returns it to theta_safe."""
