"""The guard as a ROS node, and its twin, which imports as little as it can."""
