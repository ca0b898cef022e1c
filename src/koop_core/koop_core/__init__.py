"""Base of every package: configuration, streams, kernels. Needs no ROS."""
