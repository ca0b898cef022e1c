"""Bags as arrays, and Koopman models of them. Needs no ROS."""
