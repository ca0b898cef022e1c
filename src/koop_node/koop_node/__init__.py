"""The little ROS glue that the nodes share, and the configuration classes it reads."""
