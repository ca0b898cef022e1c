"""MCAP recording of ROS 2 topics: pure writer and reader, recorder node."""
