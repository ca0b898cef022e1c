"""What every package builds on: configuration, streams, kernels. Needs no ROS."""
