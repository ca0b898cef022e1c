"""A running loop as a source. Only these modules and ``node.py`` know ROS."""
