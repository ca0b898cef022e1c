"""The little ROS glue that the nodes share: parameters from a config class, QoS, spinning, shutdown."""
