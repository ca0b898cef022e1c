"""MCAP bags of ROS 2 topics: pure writer and reader, recorder and player nodes."""
