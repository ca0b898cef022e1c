"""From a recorded excitation to a controller and its prediction. Needs no ROS."""
